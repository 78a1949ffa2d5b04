//! A choice tried on one camera: fitted to all of its views, and judged on views that took no part.
//!
//! Lens models and target shapes are chosen by what they predict. The frames are dealt into parts; each
//! part is predicted with the lens and the shape that the others give, and the pose of each of its frames
//! alone is fitted to it.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use boresight_adjust::{AdjustOptions, Hold, Rejection, adjust, optimize};
use boresight_camera::{Camera, Model};
use boresight_data::{CameraId, Dataset, FrameId, PointId, RejectionReason, Scene, Severity};
use boresight_seed::{SeedOptions, seed};

use crate::beliefs::{Beliefs, HoldChoice};
use crate::held_out::{Seen, place_frames, with_views};
use crate::options::CalibrateOptions;

/// The frames are dealt into this many parts, or one for each frame where there are fewer.
const FOLDS: usize = 4;

/// Cells of the image, across and down, in which residuals should point in no common direction.
const CELLS: [usize; 2] = [8, 6];

/// The sum of squares in px² and the number of corners of each view; `None` of one that was left out.
pub(crate) type ViewErrors = Vec<Option<(f64, usize)>>;

/// What trials go by.
#[derive(Clone, Copy)]
pub(crate) struct Terms<'a> {
    pub options: &'a CalibrateOptions,
    /// Stops every solve when it becomes true.
    pub cancel: Option<&'a Arc<AtomicBool>>,
}

impl Terms<'_> {
    /// Returns the options with what they hold of the lenses of some cameras, as far as `model` has it.
    fn of_cameras(&self, cameras: &[&str], model: Model, is_known: bool) -> CalibrateOptions {
        let is_of =
            |hold: &&HoldChoice| hold.camera.as_deref().is_none_or(|camera| cameras.contains(&camera));
        let is_here = |hold: &&HoldChoice| match hold.what.as_str() {
            "shape" => true,
            "lens" => is_known,
            name => model.param_names().contains(&name),
        };
        let hold = self.options.hold.iter().filter(is_of).filter(is_here);
        let hold = hold.map(|hold| HoldChoice { camera: None, ..hold.clone() }).collect();
        CalibrateOptions { hold, ..self.options.clone() }
    }
}

/// A model fitted to all views of a camera.
pub(crate) struct Fit {
    scene: Scene,
    /// How it was fitted.
    adjust: AdjustOptions,
    /// The corners that are outliers to it.
    pub outliers: BTreeSet<(usize, PointId)>,
    /// Why the model is out of the question, where it is.
    pub problem: Option<String>,
}

impl Fit {
    /// Fits `model` to the only camera of `dataset`, which is one of `cameras` or all of them, and says why if that
    /// cannot be done. A lens that is known is held.
    pub(crate) fn new(
        dataset: &Dataset,
        cameras: &[&str],
        model: Model,
        known: Option<&Camera>,
        terms: Terms<'_>,
    ) -> Result<Self, String> {
        let known: Vec<(CameraId, Camera)> =
            known.map(|lens| (CameraId(0), lens.clone())).into_iter().collect();
        let options = &terms.of_cameras(cameras, model, !known.is_empty());
        let seed_options =
            SeedOptions { models: vec![model], known: known.clone(), ..SeedOptions::default() };
        let mut seed = seed(dataset, &seed_options).map_err(|error| error.to_string())?;
        let mut adjust_options = AdjustOptions {
            holds: known.iter().map(|(camera, _)| Hold::Lens(*camera)).collect(),
            cancel: terms.cancel.cloned(),
            threads: 1,
            ..options.adjust_options(dataset)
        };
        let beliefs = Beliefs { options, earlier: None, stated: &known, groups: &[] };
        beliefs.apply(dataset, &mut seed.scene, &mut adjust_options).map_err(|error| error.to_string())?;
        let calibration =
            adjust(dataset, &seed.scene, &adjust_options, None).map_err(|error| error.to_string())?;
        let mut problem = (!calibration.solve.converged).then(|| "it does not converge".to_owned());
        let findings = boresight_validate::findings(dataset, &calibration);
        let folds = findings.iter().find(|f| f.code == "not-monotonic" && f.severity == Severity::Fail);
        problem = problem.or_else(|| folds.map(|finding| finding.message.clone()));
        let outliers = calibration.rejected.iter().filter_map(|rejection| match rejection.reason {
            RejectionReason::Outlier { .. } => Some((rejection.view_idx, rejection.point)),
            RejectionReason::LeftOut { .. } => None,
        });
        let outliers = outliers.collect();
        let mut scene = calibration.scene;
        for rejection in &calibration.rejected {
            if let RejectionReason::LeftOut { .. } = rejection.reason {
                scene.rig_from_target[dataset.views[rejection.view_idx].frame] = None;
            }
        }
        Ok(Self { scene, adjust: adjust_options, outliers, problem })
    }
}

/// How well views that took no part are predicted.
#[derive(Clone, Debug)]
pub(crate) struct Trial {
    /// The root of the mean squared distance of corners, in pixels.
    pub held_out_px: f64,
    /// How far the residuals point the same way in parts of the image, in pixels.
    pub bias_px: f64,
    /// View by view.
    pub views: ViewErrors,
}

impl Trial {
    /// Judges a fit to `dataset`, which holds no outliers any more, or says why it cannot be judged.
    pub(crate) fn new(dataset: &Dataset, fit: &Fit) -> Result<Self, String> {
        let residuals = residuals(dataset, fit)?;
        let of_view = |view: &Option<Vec<Residual>>| {
            let view = view.as_ref()?;
            Some((view.iter().map(|(_, r)| r[0] * r[0] + r[1] * r[1]).sum(), view.len()))
        };
        let views: ViewErrors = residuals.iter().map(of_view).collect();
        let size = dataset.cameras[CameraId(0)].image_size;
        let all = residuals.iter().flatten().flatten().copied();
        Ok(Self { held_out_px: rms_px(&views), bias_px: bias_px(all, size), views })
    }
}

/// Returns the root of the mean squared distance of all corners in pixels; infinity of none.
pub(crate) fn rms_px(views: &ViewErrors) -> f64 {
    let (square, n) = views.iter().flatten().fold((0.0, 0), |(s, n), view| (s + view.0, n + view.1));
    if n > 0 { (square / n as f64).sqrt() } else { f64::INFINITY }
}

/// Returns the root of the mean squared distance of corners for each of several choices, in pixels, over the views that all
/// of them kept: who leaves out what is hard is none the better for it. Where they share none, each is over its own.
pub(crate) fn comparable_rms_px(choices: &[&ViewErrors]) -> Vec<f64> {
    let n_views = choices.iter().map(|views| views.len()).min().unwrap_or(0);
    let is_common = |view: &usize| choices.iter().all(|views| views[*view].is_some());
    let common: Vec<usize> = (0..n_views).filter(is_common).collect();
    let over_common = |views: &&ViewErrors| rms_px(&common.iter().map(|&view| views[view]).collect());
    let over_own = |views: &&ViewErrors| rms_px(views);
    if common.is_empty() {
        choices.iter().map(over_own).collect()
    } else {
        choices.iter().map(over_common).collect()
    }
}

/// Returns by how much the sum of squares per view exceeds another's, and the standard error of that.
pub(crate) fn excess(views: &ViewErrors, others: &ViewErrors) -> (f64, f64) {
    let both = views.iter().zip(others);
    let differences: Vec<f64> = both.filter_map(|(a, b)| Some(a.as_ref()?.0 - b.as_ref()?.0)).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let square: f64 = differences.iter().map(|d| (d - mean) * (d - mean)).sum();
    (mean, (square / (n - 1.0) / n).sqrt())
}

/// Returns the dataset without some observations.
pub(crate) fn without(dataset: &Dataset, outliers: &BTreeSet<(usize, PointId)>) -> Dataset {
    let mut dataset = dataset.clone();
    for (view_idx, view) in dataset.views.iter_mut().enumerate() {
        view.observations.retain(|observation| !outliers.contains(&(view_idx, observation.point)));
    }
    dataset
}

/// Where a corner was seen, and its residual, in pixels.
type Residual = ([f64; 2], [f64; 2]);

/// Returns the residuals of every view under a lens and shape that were fitted without its frame; `None` of
/// a view that was left out.
fn residuals(dataset: &Dataset, fit: &Fit) -> Result<Vec<Option<Vec<Residual>>>, String> {
    let base = AdjustOptions { rejection: Rejection::None, ..fit.adjust.clone() };
    let frames: BTreeSet<FrameId> = dataset.views.iter().map(|view| view.frame).collect();
    let mut residuals = vec![None; dataset.views.len()];
    for fold in 0..FOLDS {
        let tested: BTreeSet<FrameId> = frames.iter().copied().skip(fold).step_by(FOLDS).collect();
        let known = |frame: FrameId| fit.scene.rig_from_target[frame].is_some();
        let training = with_views(dataset, |view| known(view.frame) && !tested.contains(&view.frame));
        let test = with_views(dataset, |view| known(view.frame) && tested.contains(&view.frame));
        if test.views.is_empty() {
            continue;
        }
        let fitted = optimize(&training, &fit.scene, &base).map_err(|error| error.to_string())?.scene;
        let start = Scene { rig_from_target: fit.scene.rig_from_target.clone(), ..fitted };
        let placed = place_frames(&test, &start, &base).map_err(|error| error.to_string())?;
        for (view, found) in dataset.views.iter().zip(&mut residuals) {
            if !tested.contains(&view.frame) {
                continue;
            }
            let Some(seen) = Seen::new(dataset, &placed, view) else { continue };
            let residual = |(point, observation): (_, &boresight_data::Observation)| {
                let pixel = seen.camera.project(point)?;
                Some((observation.pixel, [0, 1].map(|axis| pixel[axis] - observation.pixel[axis])))
            };
            *found = seen.points_in_cam.iter().zip(&view.observations).map(residual).collect();
        }
    }
    Ok(residuals)
}

/// Returns the root of the mean squared common part of the residuals in cells of the image, freed of
/// what chance alone would leave.
fn bias_px(residuals: impl Iterator<Item = Residual>, image_size: [u32; 2]) -> f64 {
    let mut cells = vec![(0.0, [0.0; 2], 0.0); CELLS[0] * CELLS[1]];
    for (pixel, r) in residuals {
        let place = [0, 1].map(|axis| {
            let across = (pixel[axis] + 0.5) / f64::from(image_size[axis]) * CELLS[axis] as f64;
            (across.max(0.0) as usize).min(CELLS[axis] - 1)
        });
        let cell = &mut cells[place[1] * CELLS[0] + place[0]];
        cell.0 += 1.0;
        (0..2).for_each(|axis| cell.1[axis] += r[axis]);
        cell.2 += r[0] * r[0] + r[1] * r[1];
    }
    let (mut sum, mut n_all) = (0.0, 0.0);
    for (n, total, square) in cells.into_iter().filter(|(n, _, _)| *n >= 2.0) {
        let common = (total[0] * total[0] + total[1] * total[1]) / (n * n);
        // The mean of n residuals scatters by their variance over n.
        let chance = (square / n - common) / (n - 1.0);
        sum += n * (common - chance);
        n_all += n;
    }
    if n_all > 0.0 { (sum / n_all).max(0.0).sqrt() } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rivals_are_compared_over_the_views_that_all_of_them_kept() {
        let (whole, less) = (vec![Some((2.0, 2)), Some((800.0, 2))], vec![Some((4.5, 2)), None]);
        assert_eq!(comparable_rms_px(&[&whole, &less]), [1.0, 1.5]);
        let other = vec![None, Some((8.0, 2))];
        assert_eq!(comparable_rms_px(&[&less, &other]), [1.5, 2.0]);
        assert!(comparable_rms_px(&[]).is_empty());
    }

    #[test]
    fn chance_is_no_bias() {
        let at = |i: usize| [(i * 37 % 800) as f64, (i * 91 % 600) as f64];
        let sign = |i: usize, by: usize| if (i / by).is_multiple_of(2) { 0.3 } else { -0.3 };
        let chance = (0..20_000).map(|i| (at(i), [sign(i, 1600), sign(i, 3200)]));
        assert!(bias_px(chance, [800, 600]) < 0.03);
        let outward = (0..20_000).map(|i| (at(i), [0.5 * (at(i)[0] - 400.0).signum(), 0.0]));
        assert!((bias_px(outward, [800, 600]) - 0.5).abs() < 0.03);
    }

    #[test]
    fn an_excess_has_its_standard_error() {
        let views =
            |squares: &[f64]| squares.iter().map(|square| Some((*square, 50))).collect::<ViewErrors>();
        let (mean, error) = excess(&views(&[3.0, 5.0, 4.0, 8.0]), &views(&[2.0, 3.0, 5.0, 2.0]));
        assert_eq!(mean, 2.0);
        // Differences 1, 2, -1, 6: their variance is 26/3, a quarter of which is that of the mean.
        assert!((error - (26f64 / 12.0).sqrt()).abs() < 1e-12, "{error}");
    }
}
