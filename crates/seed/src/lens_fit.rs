//! A lens model's parameters from a lens profile, and how freely each may move in a seed.

use boresight_camera::{Camera, Model, ParamGroup};
use boresight_geometry::nalgebra::{Cholesky, DMatrix, DVector};
use boresight_geometry::{Pose, Vector3};

use crate::kernel::{Lens, LensSum, lens_sum};
use crate::profile::Profile;
use crate::sighting::Sighting;

/// Radii at which the profile is sampled, in each of two directions.
const SAMPLES: usize = 24;
/// A model that cannot see behind itself is fitted up to this angle only, in radians; beyond, its
/// image-plane coordinates grow without bound.
pub(crate) const FORWARD_LIMIT: f64 = 1.36;

/// How freely a parameter may move while a seed is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Freedom {
    /// As the data want.
    Free,
    /// Drawn to its start, with this standard deviation.
    Near(f64),
    /// Not at all.
    Held,
}

/// Returns the freedom of each parameter.
///
/// Higher coefficients start at zero and stay near it unless the data speak up: an unregularised
/// rational lens is a nearly flat valley with many minima. The standard deviations are those which
/// mrcal's regularisation comes to on ten thousand observations (scale 2, fivefold for the
/// denominator); sensor tilt and thin prism are left to the adjustment.
pub(crate) fn freedoms(model: Model, image_size: [u32; 2]) -> Vec<Freedom> {
    let extent_px = f64::from(image_size[0].max(image_size[1]));
    let of_group = |group| match group {
        ParamGroup::Focal | ParamGroup::Sphere => Freedom::Free,
        ParamGroup::Centre => Freedom::Near(0.2 * extent_px),
        ParamGroup::Radial => Freedom::Near(1.0),
        ParamGroup::Rational => Freedom::Near(0.2),
        ParamGroup::Tangential => Freedom::Near(0.05),
        ParamGroup::ThinPrism | ParamGroup::Tilt | ParamGroup::Pupil | ParamGroup::Spline => Freedom::Held,
    };
    model.param_groups().into_iter().map(of_group).collect()
}

/// Returns the camera with the lens model nearest to `profile` about `centre`, or `None` if the fit fails.
pub(crate) fn camera_from_profile(
    model: Model,
    image_size: [u32; 2],
    centre: [f64; 2],
    profile: &Profile,
) -> Option<Camera> {
    let focal_px = profile.at(0.0);
    let core = [focal_px, focal_px, centre[0], centre[1]];
    let mut camera = Camera::new(model, model.wide(core), image_size).ok()?;
    let start = camera.params.clone();
    let samples = profile_samples(&camera, centre, profile);
    let priors = freedoms(model, image_size);
    let active: Vec<usize> =
        (0..start.len()).filter(|&i| !(2..4).contains(&i) && priors[i] != Freedom::Held).collect();
    let prior = |params: &[f64]| -> f64 {
        prior_rows(&priors, params, &start, 1.0).map(|(_, _, row)| row * row).sum()
    };

    // A wide loss: the samples are smooth, nothing in them is an outlier.
    let width = 1e3;
    let evaluate = |camera: &Camera| {
        lens_sum(Lens::of(camera), &Pose::identity(), &samples, width, &mut Vec::with_capacity(samples.len()))
    };
    let mut sum = evaluate(&camera);
    let mut damping = 1e-6;
    for _ in 0..20 {
        let step = lens_step(&sum, &active, prior_rows(&priors, &camera.params, &start, 1.0), damping)?;
        let mut trial = camera.clone();
        for (&i, d) in active.iter().zip(step.iter()) {
            trial.params[i] += d;
        }
        let Ok(trial) = Camera::new(model, trial.params, image_size) else {
            damping *= 30.0;
            continue;
        };
        let trial_sum = evaluate(&trial);
        let (before, after) =
            (sum.cost.loss + prior(&camera.params), trial_sum.cost.loss + prior(&trial.params));
        if trial_sum.cost.outside <= sum.cost.outside && after < before {
            let is_done = after > before * (1.0 - 1e-4);
            (camera, sum) = (trial, trial_sum);
            damping = (damping * 0.1).max(1e-9);
            if is_done {
                break;
            }
        } else {
            damping = (damping * 30.0).max(1e-4);
            if damping > 1e6 {
                break;
            }
        }
    }
    Some(camera)
}

/// Yields `(parameter, slope, value)` of each prior row, at a noise of `scale` sigmas.
pub(crate) fn prior_rows<'a>(
    priors: &'a [Freedom],
    params: &'a [f64],
    start: &'a [f64],
    scale: f64,
) -> impl Iterator<Item = (usize, f64, f64)> + 'a {
    priors.iter().enumerate().filter_map(move |(i, freedom)| match freedom {
        Freedom::Near(sigma) => Some((i, scale / sigma, scale / sigma * (params[i] - start[i]))),
        Freedom::Free | Freedom::Held => None,
    })
}

/// Returns points on rays that the profile pairs with pixels, as a sighting from the camera's own frame.
fn profile_samples(camera: &Camera, centre: [f64; 2], profile: &Profile) -> Sighting {
    let sees_behind = camera.project(&Vector3::new(1.0, 0.0, -0.2)).is_some();
    let limit = if sees_behind { std::f64::consts::PI } else { FORWARD_LIMIT };
    let mut samples = Sighting {
        view_idx: 0,
        points: Vec::new(),
        pixels: Vec::new(),
        weights: Vec::new(),
        plane_from_target: None,
        centroid: Vector3::z(),
        extent: 1.0,
    };
    for i in 1..=SAMPLES {
        let r = profile.radius_px * i as f64 / SAMPLES as f64;
        let angle = profile.angle_at(r);
        if angle < limit {
            let (sin, cos) = angle.sin_cos();
            samples.points.extend([Vector3::new(sin, 0.0, cos), Vector3::new(0.0, sin, cos)]);
            samples.pixels.extend([[centre[0] + r, centre[1]], [centre[0], centre[1] + r]]);
            samples.weights.extend([1.0; 2]);
        }
    }
    samples
}

/// Solves the damped normal equations of the `active` lens parameters alone.
fn lens_step(
    sum: &LensSum,
    active: &[usize],
    priors: impl Iterator<Item = (usize, f64, f64)>,
    damping: f64,
) -> Option<DVector<f64>> {
    let n = active.len();
    // The residual is the last column; see the kernel.
    let residual = sum.n_params + 6;
    let mut normal = DMatrix::from_fn(n, n, |i, j| sum.gram[active[i.min(j)]][active[i.max(j)]]);
    let mut right = DVector::from_fn(n, |i, _| -sum.gram[active[i]][residual]);
    for (param, slope, value) in priors {
        if let Some(i) = active.iter().position(|&active| active == param) {
            normal[(i, i)] += slope * slope;
            right[i] -= slope * value;
        }
    }
    for i in 0..n {
        normal[(i, i)] *= 1.0 + damping;
    }
    let step = Cholesky::new(normal)?.solve(&right);
    step.iter().all(|value| value.is_finite()).then_some(step)
}
