//! The covariance against the scatter of noisy re-draws.

use boresight_adjust::{AdjustOptions, Rejection, adjust};
use boresight_data::{Calibration, Dataset};
use boresight_synthetic::{Recipe, Synthetic, simulate};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};

const DRAWS: u64 = 200;
const SIGMA_PX: f64 = 0.3;

/// Returns the dataset with noise drawn anew.
fn redraw(synthetic: &Synthetic, seed: u64) -> Dataset {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, SIGMA_PX).unwrap();
    let mut dataset = synthetic.dataset.clone();
    for (view, clean) in dataset.views.iter_mut().zip(&synthetic.clean_px) {
        for (observation, clean) in view.observations.iter_mut().zip(clean) {
            observation.pixel = clean.map(|pixel| pixel + noise.sample(&mut rng));
            observation.sigma_px = 1.0;
        }
    }
    dataset
}

/// Returns the parameters that the covariance is of, in its order; rotations as left perturbations of the truth's.
fn parameters(calibration: &Calibration, synthetic: &Synthetic) -> Vec<f64> {
    let mut parameters = Vec::new();
    for (camera, truth) in calibration.scene.rig.cameras.iter().zip(&synthetic.truth.rig.cameras) {
        let (camera, truth) = (camera.as_ref().unwrap(), truth.as_ref().unwrap());
        parameters.extend(&camera.camera.params);
        if camera.cam_from_rig != truth.cam_from_rig {
            let moved = camera.cam_from_rig * truth.cam_from_rig.inverse();
            parameters.extend(moved.log().iter());
        }
    }
    for target in &calibration.scene.targets {
        parameters.extend(&target.shape_m);
    }
    parameters
}

#[test]
fn stereo_covariance_matches_the_scatter() {
    let recipe = Recipe { sigma_px: SIGMA_PX, ..Recipe::stereo() };
    let synthetic = simulate(&recipe, 7);
    let options = AdjustOptions { rejection: Rejection::None, ..AdjustOptions::default() };
    let mut stated: Vec<f64> = Vec::new();
    let mut names = Vec::new();
    let mut samples = Vec::new();
    let mut factors = Vec::new();
    for draw in 0..DRAWS {
        let calibration = adjust(&redraw(&synthetic, draw), &synthetic.truth, &options, None).unwrap();
        assert!(calibration.solve.converged);
        let n = calibration.uncertainty.names.len();
        let variances: Vec<f64> = (0..n).map(|i| calibration.uncertainty.covariance[i * n + i]).collect();
        if stated.is_empty() {
            stated = vec![0.0; n];
            names = calibration.uncertainty.names.clone();
        }
        stated.iter_mut().zip(&variances).for_each(|(sum, variance)| *sum += variance / DRAWS as f64);
        factors.push(calibration.uncertainty.noise_factor);
        samples.push(parameters(&calibration, &synthetic));
    }
    let n = names.len();
    assert_eq!(samples[0].len(), n, "{names:?}");
    // The scatter's own relative error is 1/sqrt(2 * 200) = 5 %; over n parameters two of those are common.
    let mut ratios = Vec::new();
    for i in 0..n {
        let mean = samples.iter().map(|s| s[i]).sum::<f64>() / DRAWS as f64;
        let scatter = samples.iter().map(|s| (s[i] - mean).powi(2)).sum::<f64>() / (DRAWS - 1) as f64;
        ratios.push((stated[i] / scatter).sqrt());
        println!("{}: stated {:.4e}, scatter {:.4e}", names[i], stated[i].sqrt(), scatter.sqrt());
    }
    let mean = ratios.iter().sum::<f64>() / n as f64;
    println!(
        "sigma over scatter: mean {mean:.3}, {:.3} to {:.3}",
        ratios.iter().fold(9.0, |a: f64, b| a.min(*b)),
        ratios.iter().fold(0.0, |a: f64, b| a.max(*b))
    );
    assert!((mean - 1.0).abs() < 0.05, "{mean}");
    // Single parameters have 5 % sampling error each; three sigmas of that.
    assert!(ratios.iter().all(|ratio| (0.85..1.17).contains(ratio)), "{ratios:?}");
    let factor = factors.iter().sum::<f64>() / DRAWS as f64;
    assert!((factor / SIGMA_PX - 1.0).abs() < 0.01, "noise {factor} against {SIGMA_PX}");
}
