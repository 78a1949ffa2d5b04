//! A small bundle adjustment of one camera: lens and poses of some of its views at once.
//!
//! Levenberg-Marquardt with the poses eliminated by Schur complement (section 6.3 of Triggs et al.
//! 2000), a Cauchy loss that narrows with the residuals, and priors on the higher lens coefficients.
//! It only has to land in the basin of the optimum; the adjustment does the rest.

use boresight_camera::Camera;
use boresight_geometry::nalgebra::{Cholesky, DMatrix, DVector, SMatrix};
use boresight_geometry::{Matrix6, Pose, Vector6};

use crate::kernel::{Cost, Lens, LensSum, lens_sum, residual_lengths};
use crate::lens_fit::{Freedom, freedoms, prior_rows};
use crate::robust::{median, width_for};
use crate::sighting::Sighting;

/// A lens and the poses of the views it was fitted to.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub camera: Camera,
    pub poses: Vec<Pose>,
    /// The median length of the residuals, in sigmas.
    pub median: f64,
    /// The number of points outside the lens's domain.
    pub outside: usize,
}

/// One linearisation of the whole problem.
struct Linearized {
    sums: Vec<LensSum>,
    lengths: Vec<f64>,
    cost: Cost,
}

impl Linearized {
    fn at(camera: &Camera, poses: &[Pose], sightings: &[Sighting], width: f64) -> Self {
        let mut lengths = Vec::with_capacity(sightings.iter().map(Sighting::len).sum());
        let mut cost = Cost::default();
        let sums = sightings.iter().zip(poses).map(|(sighting, pose)| {
            let sum = lens_sum(Lens::of(camera), pose, sighting, width, &mut lengths);
            cost += sum.cost;
            sum
        });
        let sums = sums.collect();
        Self { sums, lengths, cost }
    }
}

/// Refines a camera and poses together in at most `max_steps` steps; `None` if no point projects.
pub(crate) fn bundle(
    camera: &Camera,
    poses: &[Pose],
    sightings: &[Sighting],
    max_steps: usize,
) -> Option<Bundle> {
    let priors = freedoms(camera.model, camera.image_size);
    let active: Vec<usize> = (0..priors.len()).filter(|&i| priors[i] != Freedom::Held).collect();
    // The priors draw to the lens without distortion, wherever the start lies.
    let [width_px, height_px] = camera.image_size.map(f64::from);
    let core = [camera.params[0], camera.params[1], 0.5 * (width_px - 1.0), 0.5 * (height_px - 1.0)];
    let nominal = camera.model.undistorted(core);
    let total = |cost: &Cost, params: &[f64], width: f64| {
        let rows = prior_rows(&priors, params, &nominal, width / 3.0);
        Cost { loss: cost.loss + rows.map(|(_, _, row)| row * row).sum::<f64>(), ..*cost }
    };

    let (mut camera, mut poses) = (camera.clone(), poses.to_vec());
    let mut lengths = Vec::new();
    for (sighting, pose) in sightings.iter().zip(&poses) {
        residual_lengths(Lens::of(&camera), pose, sighting, &mut lengths);
    }
    if lengths.is_empty() {
        return None;
    }
    let mut width = width_for(median(&lengths));
    let mut current = Linearized::at(&camera, &poses, sightings, width);
    let mut damping = 1e-5;
    let mut n_refused = 0;
    for _ in 0..max_steps {
        let rows: Vec<_> = prior_rows(&priors, &camera.params, &nominal, width / 3.0).collect();
        let Some((lens_step, pose_steps)) = solve(&current.sums, &active, &rows, damping) else {
            damping = (damping * 30.0).max(1e-4);
            continue;
        };
        let mut trial = camera.params.clone();
        for (&i, step) in active.iter().zip(lens_step.iter()) {
            trial[i] += step;
        }
        let before = total(&current.cost, &camera.params, width);
        let accepted = Camera::new(camera.model, trial, camera.image_size).ok().and_then(|trial| {
            let moved: Vec<Pose> =
                poses.iter().zip(&pose_steps).map(|(pose, step)| pose.perturbed(step)).collect();
            let linearized = Linearized::at(&trial, &moved, sightings, width);
            let after = total(&linearized.cost, &trial.params, width);
            after.is_below(&before).then_some((trial, moved, linearized, after))
        });
        let Some((trial, moved, linearized, after)) = accepted else {
            damping = (damping * 30.0).max(1e-4);
            n_refused += 1;
            if n_refused > 4 {
                break;
            }
            continue;
        };
        n_refused = 0;
        damping = (damping * 0.1).max(1e-9);
        (camera, poses, current) = (trial, moved, linearized);
        let next_width = width_for(median(&current.lengths)).min(width);
        let is_done = after.loss > before.loss * (1.0 - 2e-3) && next_width > 0.99 * width;
        // Judged anew under the narrower loss; the weights of the linearisation lag one step behind.
        width = next_width;
        current.cost = Cost::of(&current.lengths, current.cost.outside, width);
        if is_done {
            break;
        }
    }
    let outside = current.cost.outside;
    Some(Bundle { camera, poses, median: median(&current.lengths), outside })
}

/// Returns the damped steps of the `active` lens parameters and of every pose.
fn solve(
    sums: &[LensSum],
    active: &[usize],
    priors: &[(usize, f64, f64)],
    damping: f64,
) -> Option<(DVector<f64>, Vec<Vector6<f64>>)> {
    let n = active.len();
    let mut reduced = DMatrix::<f64>::zeros(n, n);
    let mut right = DVector::<f64>::zeros(n);
    let mut diagonal = DVector::<f64>::zeros(n);
    for &(param, slope, value) in priors {
        if let Some(i) = active.iter().position(|&active| active == param) {
            reduced[(i, i)] += slope * slope;
            right[i] -= slope * value;
        }
    }
    let mut eliminated = Vec::with_capacity(sums.len());
    for sum in sums {
        let (pose, residual) = (sum.n_params, sum.n_params + 6);
        let mut c = Matrix6::from_fn(|i, j| sum.gram[pose + i.min(j)][pose + i.max(j)]);
        for i in 0..6 {
            c[(i, i)] *= 1.0 + damping;
        }
        let factor = Cholesky::new(c)?;
        let pose_right = Vector6::from_fn(|i, _| -sum.gram[pose + i][residual]);
        let coupling = DMatrix::from_fn(6, n, |i, j| sum.gram[active[j]][pose + i]);
        let solved = factor.solve(&coupling);
        let pose_step = factor.solve(&pose_right);
        for j in 0..n {
            diagonal[j] += sum.gram[active[j]][active[j]];
            right[j] -= sum.gram[active[j]][residual] + coupling.column(j).dot(&pose_step);
            for i in j..n {
                reduced[(i, j)] += sum.gram[active[j]][active[i]] - coupling.column(i).dot(&solved.column(j));
            }
        }
        eliminated.push((pose_step, solved));
    }
    for i in 0..n {
        reduced[(i, i)] += damping * diagonal[i];
    }
    // Scaled to a unit diagonal: focal lengths and coefficients differ by many orders of magnitude.
    let scale = reduced.diagonal().map(|value| value.max(f64::MIN_POSITIVE).sqrt());
    for j in 0..n {
        right[j] /= scale[j];
        for i in j..n {
            reduced[(i, j)] /= scale[i] * scale[j];
        }
    }
    let lens_step = Cholesky::new(reduced)?.solve(&right).component_div(&scale);
    let pose_steps = eliminated
        .into_iter()
        .map(|(pose_step, solved)| {
            let correction: SMatrix<f64, 6, 1> =
                SMatrix::from_fn(|i, _| solved.row(i).transpose().dot(&lens_step));
            pose_step - correction
        })
        .collect();
    lens_step.iter().all(|value| value.is_finite()).then_some((lens_step, pose_steps))
}
