//! How far a robot's readings are off, estimated from the same data: variance components.
//!
//! Pixels, rotations and translations are three groups of residuals, each with a variance of its own.
//! With weights from the present variances, the expected sum of squares of a group is its redundancy:
//! its number of rows minus the trace of its share of the inverse normal matrix. Setting the variance so
//! that both agree, again and again, ends at the restricted maximum likelihood (Förstner 1979; Koch 1999,
//! section 3.6).

use boresight_data::{Dataset, Scene};
use boresight_geometry::Matrix6;
use boresight_geometry::nalgebra::{DMatrix, SMatrix};
use boresight_solver::{Term, covariance, solve};

use crate::adjust::{named, solve_options};
use crate::error::Error;
use crate::options::{AdjustOptions, RobotNoise};
use crate::rig_problem::RigProblem;

/// The largest number of rounds; ten are usual.
const MAX_ROUNDS: usize = 60;
/// Rounds end when no sigma changes by more than this share any more.
const SETTLED_BELOW: f64 = 2e-3;
/// Sigmas below which a robot counts as exact.
const LEAST: RobotNoise = RobotNoise { rotation_rad: 1e-8, translation_m: 1e-8, stretch: Some(1e-8) };
/// The change of a variance's logarithm over which redundancies are differentiated.
const STEP: f64 = 0.02;

/// A group with less redundancy than this says nothing of its variance, which has run to its least.
const NO_REDUNDANCY: f64 = 1e-3;

/// A robot's noise as the data tell it.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatedNoise {
    /// The standard deviations, in true units.
    pub noise: RobotNoise,
    /// The same in units of the pixels' stated sigmas, for [`AdjustOptions::robot_noise`].
    pub relative: RobotNoise,
    /// The relative standard deviations of the two, from the information that restricted likelihood has of them.
    pub relative_sigmas: [f64; 2],
    /// The redundancies of rotations and translations: how many rows they amount to.
    pub redundancies: [f64; 2],
    /// The factor by which the stated sigmas of pixels must grow to explain their residuals.
    pub pixel_factor: f64,
    /// The scene that goes with it.
    pub scene: Scene,
    /// The number of rounds, and whether the last changed nothing.
    pub rounds: (usize, bool),
}

/// Estimates the noise of the robot's readings together with everything else, from a scene near the optimum.
///
/// Observations that are outliers must have been taken out. Returns `None` if the scene has no robot.
pub fn estimate_robot_noise(
    dataset: &Dataset,
    start: &Scene,
    first: RobotNoise,
    options: &AdjustOptions,
) -> Result<Option<EstimatedNoise>, Error> {
    let mut relative = first;
    let mut scene = start.clone();
    for round in 1..=MAX_ROUNDS {
        let options = AdjustOptions { robot_noise: Some(relative), ..options.clone() };
        let mut rig = RigProblem::new(dataset, &scene, &options)?;
        if rig.robot.readings.is_empty() {
            return Ok(None);
        }
        let solve_options = solve_options(&options, options.decrease_below);
        let solution = {
            let problem = rig.problem()?;
            solve(&problem, &solve_options).map_err(|error| named(error, &rig))?
        };
        rig.parameters.set_values(&solution.values);
        scene = rig.scene(dataset, &scene, rig.parameters.values());
        let groups = Groups::of(&rig, &solve_options)?;
        let pixel_variance = groups.pixels.variance();
        let mut largest_change = 0.0f64;
        let mut update = |sigma: f64, group: &Group, least: f64| {
            let factor = (group.variance() / pixel_variance).sqrt();
            let next = (sigma * factor).max(least);
            largest_change = largest_change.max((next / sigma - 1.0).abs());
            next
        };
        relative = RobotNoise {
            rotation_rad: update(relative.rotation_rad, &groups.rotations, LEAST.rotation_rad),
            translation_m: update(relative.translation_m, &groups.translations, LEAST.translation_m),
            stretch: relative.stretch.map(|sigma| update(sigma, &groups.stretch, LEAST.rotation_rad)),
        };
        let is_settled = largest_change < SETTLED_BELOW;
        if is_settled || round == MAX_ROUNDS {
            let pixel_factor = pixel_variance.sqrt();
            let redundancies = [groups.rotations.redundancy, groups.translations.redundancy];
            let relative_sigmas = relative_sigmas(&groups, relative, |noise| {
                let options = AdjustOptions { robot_noise: Some(noise), ..options.clone() };
                Groups::of(&RigProblem::new(dataset, &scene, &options)?, &solve_options)
            })?;
            return Ok(Some(EstimatedNoise {
                noise: RobotNoise {
                    rotation_rad: relative.rotation_rad * pixel_factor,
                    translation_m: relative.translation_m * pixel_factor,
                    stretch: relative.stretch.map(|sigma| sigma * pixel_factor),
                },
                relative,
                relative_sigmas,
                redundancies,
                pixel_factor,
                scene,
                rounds: (round, is_settled),
            }));
        }
    }
    unreachable!("the last round returns")
}

/// Returns the relative standard deviations of the sigmas of rotations and translations.
///
/// With R the redundancy matrix of the weighted rows, the information of two variances' logarithms is half the sum of
/// squares of the entries that R has between their rows (Patterson & Thompson 1971). R is idempotent, so that all sums
/// of a group add up to its redundancy r; and as ∂r_i/∂log σ_j² is `δ_ij r_i` less the sum of i and j, redundancies
/// at other variances (`groups_at`) tell them.
fn relative_sigmas(
    groups: &Groups,
    noise: RobotNoise,
    groups_at: impl Fn(RobotNoise) -> Result<Groups, Error>,
) -> Result<[f64; 2], Error> {
    let redundancies = groups.redundancies();
    // Where no stretch is estimated, or the data tell of none, its group is empty.
    let n = if redundancies[2] > NO_REDUNDANCY { 3 } else { 2 };
    let mut sums = DMatrix::zeros(n + 1, n + 1);
    for j in 0..n {
        let at = |sense: f64| {
            let factor = (0.5 * sense * STEP).exp();
            let mut noise = noise;
            match j {
                0 => noise.rotation_rad *= factor,
                1 => noise.translation_m *= factor,
                _ => noise.stretch = noise.stretch.map(|sigma| sigma * factor),
            }
            groups_at(noise).map(|groups| groups.redundancies())
        };
        let (more, less) = (at(1.0)?, at(-1.0)?);
        for i in 0..n {
            let own = if i == j { redundancies[i] } else { 0.0 };
            sums[(i, j)] = own - (more[i] - less[i]) / (2.0 * STEP);
        }
    }
    sums = 0.5 * (&sums + sums.transpose());
    for i in 0..n {
        let with_pixels = redundancies[i] - sums.row(i).sum();
        (sums[(i, n)], sums[(n, i)]) = (with_pixels, with_pixels);
    }
    sums[(n, n)] = groups.pixels.redundancy - sums.row(n).sum();
    // Variances that nothing tells have no information at all. A sigma's logarithm is half that of its variance.
    let covariance = (0.5 * sums).cholesky().map(|factor| factor.inverse());
    Ok([0, 1].map(|i| covariance.as_ref().map_or(f64::INFINITY, |c| 0.5 * c[(i, i)].sqrt())))
}

/// Residuals that share a variance.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    /// The sum of squared residuals, in units of the present variance.
    cost: f64,
    redundancy: f64,
}

impl Group {
    /// Returns the variance in units of the present one.
    fn variance(&self) -> f64 {
        self.cost / self.redundancy.max(1e-6)
    }
}

struct Groups {
    pixels: Group,
    rotations: Group,
    translations: Group,
    stretch: Group,
}

impl Groups {
    /// Returns the redundancies of rotations, translations and stretch.
    fn redundancies(&self) -> [f64; 3] {
        [&self.rotations, &self.translations, &self.stretch].map(|group| group.redundancy)
    }

    fn of(rig: &RigProblem, options: &boresight_solver::SolveOptions) -> Result<Self, Error> {
        let problem = rig.problem()?;
        let values = rig.parameters.values();
        let covariance = covariance(&problem, values.as_slice(), options)?;
        let (mut rotations, mut translations) = (Group::default(), Group::default());
        for reading in rig.robot.all_readings() {
            let (residuals, jacobian) = reading.rows(values);
            // The rows' own variances come from pose and map together; what both share is in the cross terms.
            let own = covariance.eliminated(reading.pose()).unwrap_or_default();
            let own = Matrix6::from_fn(|row, column| own[row][column]);
            let by_pose = jacobian.fixed_columns::<6>(0).into_owned();
            let mut shares = (by_pose * own * by_pose.transpose()).diagonal();
            if let Some(stretch) = &rig.robot.stretch {
                let by_map = jacobian.fixed_columns::<9>(6).into_owned();
                let of_map = SMatrix::<f64, 9, 9>::from_fn(|a, b| {
                    covariance.between((stretch.block, a), (stretch.block, b))
                });
                let both = covariance.eliminated_with(reading.pose(), stretch.block);
                let both = SMatrix::<f64, 6, 9>::from_fn(|a, b| both[a][b]);
                shares += (by_map * of_map * by_map.transpose()).diagonal()
                    + 2.0 * (by_pose * both * by_map.transpose()).diagonal();
            }
            for (group, rows) in [(&mut rotations, 0..3), (&mut translations, 3..6)] {
                for row in rows {
                    group.cost += residuals[row] * residuals[row];
                    group.redundancy += 1.0 - shares[row];
                }
            }
        }
        let mut stretch = Group::default();
        if let Some(block) = &rig.robot.stretch {
            for (i, number) in values.vector(block.block).iter().enumerate() {
                let variance = covariance.between((block.block, i), (block.block, i));
                stretch.cost += (number / block.sigma).powi(2);
                stretch.redundancy += 1.0 - variance / (block.sigma * block.sigma);
            }
        }
        let n_pixels: usize = rig.views.iter().map(|(_, term)| term.row_count()).sum();
        let n_priors: usize = rig.priors.iter().map(Term::row_count).sum();
        let n_robot = 6 * rig.robot.all_readings().count();
        // Touches have a sigma that is stated, as pixels have, and few of them change nothing about the pixels' factor.
        let n_touched: usize = rig.robot.touched.iter().map(Term::row_count).sum();
        // Redundancies of all groups add up to rows minus unknowns. What few priors there are count as
        // much as they have rows, which is right where they decide and off by one at most elsewhere.
        let n_stretch = if rig.robot.stretch.is_some() { 9 } else { 0 };
        let all = (n_pixels + n_touched + n_priors + n_robot + n_stretch) as f64
            - rig.parameters.free_count() as f64;
        let pixels = Group {
            cost: covariance.observation_cost - rotations.cost - translations.cost,
            redundancy: (all - rotations.redundancy - translations.redundancy - stretch.redundancy).max(1.0),
        };
        Ok(Self { pixels, rotations, translations, stretch })
    }
}
