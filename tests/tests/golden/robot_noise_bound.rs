//! How well any estimator can tell a robot's noise from few poses, and how near to it ours comes.
//!
//! The relative sigma of a variance component has a bound: what the restricted likelihood of all data knows of it
//! (Cramér & Rao). An estimator that reaches it scatters as chi-squared of `1 / (2 bound²)` degrees of freedom.

use boresight_adjust::{RobotNoise, estimate_robot_noise};
use boresight_synthetic::{Recipe, RobotRecipe};

use super::hand_eye::{NOISE, options, recording};

/// Returns the probability that a normal number is below `x`, by Simpson's rule.
fn normal_below(x: f64) -> f64 {
    const STEPS: usize = 400;
    let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    let step = x / STEPS as f64;
    let weight = |i: usize| match i {
        0 | STEPS => 1.0,
        _ if i % 2 == 1 => 4.0,
        _ => 2.0,
    };
    0.5 + (0..=STEPS).map(|i| weight(i) * density(step * i as f64)).sum::<f64>() * step / 3.0
}

/// Returns how often the root of chi-squared over its `n` degrees of freedom is within `share` of one
/// (Wilson & Hilferty 1931).
fn within(share: f64, n: f64) -> f64 {
    let sigma = (2.0 / (9.0 * n)).sqrt();
    let below = |ratio: f64| normal_below((ratio.powf(2.0 / 3.0) - 1.0 + sigma * sigma) / sigma);
    below(1.0 + share) - below(1.0 - share)
}

#[test]
fn the_share_of_chi_squared_is_right() {
    // Chi-squared of 30 is below 0.49 * 30 with probability 0.00867 and below 1.69 * 30 with 0.98952.
    assert!((within(0.3, 30.0) - 0.98085).abs() < 1e-3, "{}", within(0.3, 30.0));
    assert!((normal_below(1.96) - 0.975).abs() < 1e-4);
}

#[test]
#[ignore = "some minutes; prints the table of docs/hand-eye.md"]
fn noise_is_told_as_well_as_can_be() {
    const DRAWS: u64 = 100;
    for frames in [15, 25, 40, 60] {
        let recipe = Recipe { frames, ..Recipe::mono() };
        // Rotations, translations: bounds, squared deviations, how many are within 30 % of sigma and of variance.
        let mut bounds = [0.0; 2];
        let mut squares = [0.0; 2];
        let mut near = [[0; 2]; 2];
        for seed in 0..DRAWS {
            let robot = if seed % 2 == 0 { RobotRecipe::on_flange() } else { RobotRecipe::fixed() };
            let made = recording(recipe.clone(), robot, seed);
            let start = RobotNoise { rotation_rad: 1e-3, translation_m: 1e-3, stretch: None };
            let found =
                estimate_robot_noise(&made.dataset, &made.truth, start, &options(None)).unwrap().unwrap();
            let ratios = [
                found.noise.rotation_rad / NOISE.rotation_rad,
                found.noise.translation_m / NOISE.translation_m,
            ];
            for which in 0..2 {
                bounds[which] += found.relative_sigmas[which] / DRAWS as f64;
                squares[which] += (ratios[which] - 1.0).powi(2) / DRAWS as f64;
                near[which][0] += u64::from((ratios[which] - 1.0).abs() < 0.3);
                near[which][1] += u64::from((ratios[which].powi(2) - 1.0).abs() < 0.3);
            }
        }
        for (which, name) in ["rotation", "translation"].into_iter().enumerate() {
            let n = 0.5 / (bounds[which] * bounds[which]);
            let percent = |count: u64| 100.0 * count as f64 / DRAWS as f64;
            // Of a variance, 30 % are 14 % and 16 % of its root.
            let of_variance = 0.5 * (within(1.3f64.sqrt() - 1.0, n) + within(1.0 - 0.7f64.sqrt(), n));
            println!(
                "row: {frames}, {name} | {:.1} % | {:.1} % | {:.0} % | {:.0} % | {:.0} % | {:.0} %",
                100.0 * bounds[which],
                100.0 * squares[which].sqrt(),
                percent(near[which][0]),
                100.0 * within(0.3, n),
                percent(near[which][1]),
                100.0 * of_variance,
            );
            // 100 draws tell a scatter to 7 %.
            let efficiency = squares[which].sqrt() / bounds[which];
            assert!((0.8..1.25).contains(&efficiency), "{frames} {name}: {efficiency}");
        }
    }
}
