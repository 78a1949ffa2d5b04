//! One lens model fitted to another over the image: what is lost by a change of model, in pixels.

use boresight_camera::{Camera, Model};
use boresight_geometry::nalgebra::{Cholesky, DMatrix, DVector};
use boresight_geometry::{Pose, Vector3, Vector6};

use crate::kernel::{Lens, LensSum, lens_sum};
use crate::lens_fit::FORWARD_LIMIT;
use crate::local_fit::camera_from_lens;
use crate::sighting::Sighting;

/// Columns and rows of the grid of pixels that is fitted, and of the one that the error is told on.
const FITTED: [u32; 2] = [40, 30];
const JUDGED: [u32; 2] = [97, 73];
/// Fewer samples than this determine no lens.
const MIN_SAMPLES: usize = 50;
/// Steps of a fit; rational lenses have long valleys.
const MAX_STEPS: usize = 200;
/// The fit has settled when a step lowers the sum of squares by less than this share.
const SETTLED: f64 = 1e-10;

/// Whether the camera may turn as its lens model changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImpliedRotation {
    /// The rotation is fitted, as models differ in how they share it with their centre.
    #[default]
    Fitted,
    /// The camera keeps its orientation.
    None,
}

/// A camera whose lens model was exchanged.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    /// The camera with its new lens model.
    pub camera: Camera,
    /// From the frame of the camera as it was to that of the camera as it is: a rotation.
    pub new_from_old: Pose,
    /// The root mean square of the distances between both models' pixels.
    pub rms_px: f64,
    /// The largest of these distances.
    pub max_px: f64,
    /// The share of the image that the old model sees and on which both can be compared.
    pub share: f64,
}

/// What can keep a lens model from being exchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// The camera sees too little of its own image.
    #[error("lens model {model} has a ray for {found} of {tried} pixels; {MIN_SAMPLES} are needed")]
    TooFewRays {
        /// The camera's lens model.
        model: Model,
        /// Pixels with a ray.
        found: usize,
        /// Pixels tried.
        tried: usize,
    },
    /// No fit of the new model arrives anywhere.
    #[error("lens model {to} cannot follow {from}")]
    NoFit {
        /// The camera's lens model.
        from: Model,
        /// The model asked for.
        to: Model,
    },
}

/// Returns the camera of `model` nearest to `source` over all of its image that `source` has rays for.
///
/// A model that cannot see beyond 90 degrees is fitted up to 78 degrees off axis; `share` tells how
/// much of the image that is.
pub fn convert(source: &Camera, model: Model, rotation: ImpliedRotation) -> Result<Converted, ConvertError> {
    let rays = rays(source, FITTED);
    if rays.len() < MIN_SAMPLES {
        let tried = (FITTED[0] * FITTED[1]) as usize;
        return Err(ConvertError::TooFewRays { model: source.model, found: rays.len(), tried });
    }
    let no_fit = ConvertError::NoFit { from: source.model, to: model };
    if source.model == model {
        return Ok(judged(source, source.clone(), Pose::identity()));
    }
    if model.local_support().is_some() || !model.is_complete() {
        let camera = camera_from_lens(model, source).ok_or(no_fit)?;
        return Ok(judged(source, camera, Pose::identity()));
    }
    let core = core_of(source).ok_or(no_fit.clone())?;
    let mut best: Option<Fit> = None;
    for start in [model.wide(core), model.undistorted(core)] {
        let Ok(camera) = Camera::new(model, start, source.image_size) else { continue };
        let samples = samples(&camera, &rays);
        let Some(fit) = Fit::run(camera, &samples, rotation) else { continue };
        let is_better = |best: &Fit| {
            (fit.sum.cost.outside, fit.sum.cost.loss) < (best.sum.cost.outside, best.sum.cost.loss)
        };
        if best.as_ref().is_none_or(is_better) {
            best = Some(fit);
        }
    }
    let Fit { camera, new_from_old, .. } = best.ok_or(no_fit)?;
    Ok(judged(source, camera, new_from_old))
}

/// Returns pixels over the image with the rays that `source` has for them.
fn rays(source: &Camera, [columns, rows]: [u32; 2]) -> Vec<([f64; 2], Vector3<f64>)> {
    let [right, bottom] = source.image_size.map(|size| f64::from(size) - 1.0);
    let mut rays = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let share = [f64::from(column) / f64::from(columns - 1), f64::from(row) / f64::from(rows - 1)];
            let pixel = [share[0] * right, share[1] * bottom];
            rays.extend(source.unproject(pixel).map(|ray| (pixel, ray)));
        }
    }
    rays
}

/// Returns the core of a lens without distortion that is as `source` near its axis.
fn core_of(source: &Camera) -> Option<[f64; 4]> {
    const STEP: f64 = 1e-4;
    let at = |x: f64, y: f64| source.project(&Vector3::new(x, y, 1.0));
    let [cx, cy] = at(0.0, 0.0)?;
    let focal = [
        (at(STEP, 0.0)?[0] - at(-STEP, 0.0)?[0]) / (2.0 * STEP),
        (at(0.0, STEP)?[1] - at(0.0, -STEP)?[1]) / (2.0 * STEP),
    ];
    focal.iter().all(|focal| *focal > 0.0).then_some([focal[0], focal[1], cx, cy])
}

/// Returns the rays that `camera` can be fitted to, as a sighting from the camera's own frame.
fn samples(camera: &Camera, rays: &[([f64; 2], Vector3<f64>)]) -> Sighting {
    let sees_behind = camera.project(&Vector3::new(1.0, 0.0, -0.2)).is_some();
    let limit = if sees_behind { std::f64::consts::PI } else { FORWARD_LIMIT };
    let within = rays.iter().filter(|(_, ray)| ray.xy().norm().atan2(ray.z) < limit);
    let (pixels, points): (Vec<[f64; 2]>, Vec<Vector3<f64>>) = within.copied().unzip();
    Sighting {
        view_idx: 0,
        weights: vec![1.0; pixels.len()],
        points,
        pixels,
        plane_from_target: None,
        centroid: Vector3::z(),
        extent: 1.0,
    }
}

/// A lens on its way to the samples.
struct Fit {
    camera: Camera,
    new_from_old: Pose,
    sum: LensSum,
}

impl Fit {
    /// Runs Levenberg and Marquardt's method from `camera`.
    fn run(camera: Camera, samples: &Sighting, rotation: ImpliedRotation) -> Option<Self> {
        // So wide a loss weighs all alike; its own sum would drown in rounding.
        const WIDTH: f64 = 1e9;
        let evaluate = |camera: &Camera, pose: &Pose| {
            let mut lengths = Vec::with_capacity(samples.len());
            let mut sum = lens_sum(Lens::of(camera), pose, samples, WIDTH, &mut lengths);
            sum.cost.loss = lengths.iter().map(|length| length * length).sum();
            sum
        };
        let new_from_old = Pose::identity();
        let sum = evaluate(&camera, &new_from_old);
        if sum.cost.inside < MIN_SAMPLES {
            return None;
        }
        let mut fit = Self { camera, new_from_old, sum };
        let mut damping = 1e-4;
        for _ in 0..MAX_STEPS {
            let step = fit.step(rotation, damping);
            let trial = step.and_then(|(lens, turn)| {
                let params = fit.camera.params.iter().zip(lens.iter()).map(|(param, d)| param + d).collect();
                let camera = Camera::new(fit.camera.model, params, fit.camera.image_size).ok()?;
                let new_from_old = fit.new_from_old.perturbed(&turn);
                let sum = evaluate(&camera, &new_from_old);
                sum.cost.is_below(&fit.sum.cost).then_some(Self { camera, new_from_old, sum })
            });
            match trial {
                Some(trial) => {
                    let is_settled = trial.sum.cost.outside == fit.sum.cost.outside
                        && trial.sum.cost.loss >= fit.sum.cost.loss * (1.0 - SETTLED);
                    fit = trial;
                    damping = (damping * 0.1).max(1e-12);
                    if is_settled || fit.sum.cost.loss < 1e-18 {
                        break;
                    }
                }
                None => {
                    damping *= 10.0;
                    if damping > 1e8 {
                        break;
                    }
                }
            }
        }
        Some(fit)
    }

    /// Returns the damped step of the lens, and of the rotation if it is free.
    fn step(&self, rotation: ImpliedRotation, damping: f64) -> Option<(DVector<f64>, Vector6<f64>)> {
        let n_lens = self.sum.n_params;
        let n = n_lens + if rotation == ImpliedRotation::Fitted { 3 } else { 0 };
        let residual = n_lens + 6;
        let gram = &self.sum.gram;
        // Scaled to a unit diagonal: focal lengths and coefficients differ by many orders of magnitude.
        // What nothing depends on yet stays where it is.
        let scale = DVector::from_fn(n, |i, _| if gram[i][i] > 0.0 { gram[i][i].sqrt() } else { 1.0 });
        let mut normal = DMatrix::from_fn(n, n, |i, j| gram[i.min(j)][i.max(j)] / (scale[i] * scale[j]));
        for i in 0..n {
            normal[(i, i)] += damping;
        }
        let right = DVector::from_fn(n, |i, _| -gram[i][residual] / scale[i]);
        let step = Cholesky::new(normal)?.solve(&right).component_div(&scale);
        let mut turn = Vector6::zeros();
        for i in n_lens..n {
            turn[i - n_lens] = step[i];
        }
        step.iter().all(|value| value.is_finite()).then(|| (step.rows(0, n_lens).into_owned(), turn))
    }
}

/// Returns the converted camera with its error over a grid finer than the one fitted.
fn judged(source: &Camera, camera: Camera, new_from_old: Pose) -> Converted {
    let rays = rays(source, JUDGED);
    let samples = samples(&camera, &rays);
    let (mut square, mut largest, mut n_seen) = (0.0_f64, 0.0_f64, 0_u32);
    for (pixel, ray) in samples.pixels.iter().zip(&samples.points) {
        let Some(found) = camera.project(&(new_from_old.rotation * ray)) else { continue };
        let distance = (found[0] - pixel[0]).hypot(found[1] - pixel[1]);
        square += distance * distance;
        largest = largest.max(distance);
        n_seen += 1;
    }
    let rms_px = (square / f64::from(n_seen.max(1))).sqrt();
    let share = f64::from(n_seen) / rays.len().max(1) as f64;
    Converted { camera, new_from_old, rms_px, max_px: largest, share }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(source: &str, params: &[f64], model: &str, max_px: f64, share: f64) {
        let source = Camera::new(source.parse().unwrap(), params.to_vec(), [1600, 1200]).unwrap();
        let converted = convert(&source, model.parse().unwrap(), ImpliedRotation::Fitted).unwrap();
        let (from, found) = (source.model, &converted);
        assert!(found.max_px <= max_px && found.rms_px <= found.max_px, "{from} to {model}: {found:?}");
        assert!(found.share >= share, "{from} to {model}: {found:?}");
    }

    #[test]
    fn models_that_contain_another_become_it() {
        let core = [800.0, 805.0, 790.0, 610.0];
        // A few millionths of a pixel: where the fit stops.
        check("opencv5", &[&core[..], &[-0.2, 0.05, 1e-3, -5e-4, 0.01]].concat(), "opencv8", 1e-4, 1.0);
        check("pinhole", &core, "opencv5", 1e-5, 1.0);
        check("stereographic", &core, "eucm", 1e-5, 1.0);
        check("stereographic", &core, "mei", 1e-5, 1.0);
        check("stereographic", &core, "division", 1e-5, 1.0);
        check("stereographic", &core, "double-sphere", 1e-5, 1.0);
    }

    #[test]
    fn models_that_differ_tell_by_how_much() {
        let fisheye = [380.0, 381.0, 795.0, 605.0, -0.01, 0.005, -0.002, 3e-4];
        // Corners at 95 degrees; those of the lens above are at 150, where no double sphere follows.
        let narrower = [600.0, 601.0, 795.0, 605.0, -0.01, 0.005, -0.002, 3e-4];
        check("kannala-brandt4", &narrower, "double-sphere", 5.0, 1.0);
        check("kannala-brandt4", &fisheye, "splined3", 0.1, 1.0);
        let source = Camera::new("kannala-brandt4".parse().unwrap(), fisheye.to_vec(), [1600, 1200]).unwrap();
        let pinhole = convert(&source, "pinhole".parse().unwrap(), ImpliedRotation::None).unwrap();
        assert!(pinhole.max_px > 50.0 && pinhole.share < 0.9, "{pinhole:?}");
        assert_eq!(pinhole.new_from_old, Pose::identity());
    }

    #[test]
    fn a_camera_that_sees_nothing_is_told() {
        let model: Model = "cahvore:linearity=0".parse().unwrap();
        let params = [600.0, 600.0, 800.0, 600.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0];
        let source = Camera::new(model, params.to_vec(), [1600, 1200]).unwrap();
        let error = convert(&source, "opencv8".parse().unwrap(), ImpliedRotation::Fitted).unwrap_err();
        assert_eq!(
            error.to_string(),
            "lens model cahvore:linearity=0 has a ray for 0 of 1200 pixels; 50 are needed"
        );
    }
}
