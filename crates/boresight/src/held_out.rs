//! Held-out error: how well calibrations without a part of the frames predict that part.
//!
//! The frames are dealt into folds like cards, so that each fold is spread over the recording. For each
//! fold, everything but its frames is solved anew, from the full solution, which is near; corners that
//! the full solution rejects are in neither part. Then the poses of the fold's frames are fitted to all
//! of their corners, with lenses, rig and target as the others left them: what a pose cannot make up for
//! is the error. A pose takes up six degrees of freedom of its frame's corners, which the mean is
//! taken without; so noise alone gives a ratio of one, or slightly more, for estimates from fewer frames.
//!
//! A camera is predicted only if enough is left of it to determine it: three views, and a chain of shared
//! frames to the reference camera. What is not predicted is counted.

use std::collections::{BTreeMap, BTreeSet};

use boresight_adjust::{AdjustOptions, Hold, Rejection, optimize};
use boresight_data::{
    Calibration, CameraId, Dataset, FrameId, HeldOut, Observation, PointId, Scene, TargetId, Transfer, View,
};
use boresight_geometry::Pose;
use rayon::prelude::*;

use crate::choices::HoldoutChoice;
use crate::error::Error;

/// Views that must be left of a camera for it to be predicted.
const LEAST_VIEWS: usize = 3;

/// With no more frames than this, each is left out alone.
const SMALL: usize = 20;

/// The number of folds of larger datasets, unless told otherwise.
const FOLDS: usize = 5;

/// Returns how well calibrations without a part of the frames predict that part; `None` if it is
/// switched off or there are fewer than two frames.
///
/// `options` are those that `calibration` was made with.
pub fn held_out(
    dataset: &Dataset,
    calibration: &Calibration,
    options: &AdjustOptions,
    choice: HoldoutChoice,
) -> Result<Option<HeldOut>, Error> {
    let kept = without_rejected(dataset, calibration);
    let frames: BTreeSet<FrameId> = kept.views.iter().map(|view| view.frame).collect();
    let frames: Vec<FrameId> = frames.into_iter().collect();
    let n_folds = match choice {
        HoldoutChoice::Off => return Ok(None),
        HoldoutChoice::Auto if frames.len() <= SMALL => frames.len(),
        HoldoutChoice::Auto => FOLDS,
        HoldoutChoice::Folds(n) => n.min(frames.len()),
    };
    if n_folds < 2 {
        return Ok(None);
    }
    let fold_options = AdjustOptions {
        rejection: Rejection::None,
        threads: 1,
        checkpoint: None,
        // A thousandth of the noise is far below what a fold shows.
        decrease_below: options.decrease_below.max(1e-4),
        ..options.clone()
    };
    let judged: Vec<Sums> = (0..n_folds)
        .into_par_iter()
        .map(|fold| {
            let test: BTreeSet<FrameId> = frames.iter().copied().skip(fold).step_by(n_folds).collect();
            judge_fold(&kept, &calibration.scene, &fold_options, &test)
        })
        .collect::<Result<_, Error>>()?;
    let mut total = Sums::default();
    judged.iter().for_each(|sums| total.add(sums));
    if total.n_observations == 0 || 2 * total.n_observations <= 6 * total.n_frames {
        return Ok(None);
    }
    let degrees_of_freedom = 2 * total.n_observations - 6 * total.n_frames;
    let in_sample = in_sample(&kept, calibration);
    // Of squares, as the errors are: with a robust loss the calibration's own noise factor is of that.
    let freedom = calibration.uncertainty.degrees_of_freedom.max(1) as f64;
    let noise = (judge(&kept, &calibration.scene).chi2 / freedom).sqrt();
    let per_freedom = 2.0 / degrees_of_freedom as f64;
    let camera_rms = |(camera, (sum, n)): (&CameraId, &(f64, usize))| {
        let name = dataset.cameras.get(*camera).map_or_else(String::new, |camera| camera.name.clone());
        (name, (sum / (*n).max(1) as f64).sqrt())
    };
    let transfer = (total.transfer.0 > 0).then(|| {
        let n = total.transfer.0 as f64;
        Transfer {
            observations: total.transfer.0,
            rms_px: (total.transfer.1 / n).sqrt(),
            rms_mm: 1e3 * (total.transfer.2 / n).sqrt(),
        }
    });
    Ok(Some(HeldOut {
        folds: n_folds,
        frames: total.n_frames,
        views: total.n_views,
        observations: total.n_observations,
        degrees_of_freedom,
        rms_px: (per_freedom * total.square_px2).sqrt(),
        in_sample_rms_px: in_sample,
        ratio: (total.chi2 / degrees_of_freedom as f64).sqrt() / noise,
        cameras_px: total.cameras.iter().map(camera_rms).collect(),
        transfer,
        untested_views: kept.views.len() - total.n_views,
    }))
}

/// Returns the calibration's own RMS in pixels with the mean taken over its degrees of freedom.
fn in_sample(kept: &Dataset, calibration: &Calibration) -> f64 {
    let n = kept.observation_count() as f64;
    let freedom = calibration.uncertainty.degrees_of_freedom.max(1) as f64;
    calibration.rms_px * (2.0 * n / freedom).sqrt()
}

/// What predictions add up to.
#[derive(Clone, Debug, Default)]
struct Sums {
    n_frames: usize,
    n_views: usize,
    n_observations: usize,
    square_px2: f64,
    chi2: f64,
    /// By camera: squared distances in px² and how many.
    cameras: BTreeMap<CameraId, (f64, usize)>,
    /// Corners predicted from another camera: how many, squares in px², squares in m².
    transfer: (usize, f64, f64),
}

impl Sums {
    fn add(&mut self, other: &Sums) {
        self.n_frames += other.n_frames;
        self.n_views += other.n_views;
        self.n_observations += other.n_observations;
        self.square_px2 += other.square_px2;
        self.chi2 += other.chi2;
        for (camera, (sum, n)) in &other.cameras {
            let own = self.cameras.entry(*camera).or_default();
            own.0 += sum;
            own.1 += n;
        }
        self.transfer.0 += other.transfer.0;
        self.transfer.1 += other.transfer.1;
        self.transfer.2 += other.transfer.2;
    }
}

/// Solves without the frames of `test` and predicts them.
fn judge_fold(
    kept: &Dataset,
    full: &Scene,
    options: &AdjustOptions,
    test: &BTreeSet<FrameId>,
) -> Result<Sums, Error> {
    let training = with_views(kept, |view| !test.contains(&view.frame));
    let determined = determined_cameras(&training, full);
    let tested = with_views(kept, |view| test.contains(&view.frame) && determined.contains(&view.camera));
    if tested.views.is_empty() || training.views.is_empty() {
        return Ok(Sums::default());
    }
    let mut scene = match optimize(&training, full, options) {
        Ok(optimum) => optimum.scene,
        // Too little is left to predict anything from.
        Err(boresight_adjust::Error::TooFewEquations { .. }) => return Ok(Sums::default()),
        Err(error) => return Err(error.into()),
    };
    scene.rig_from_target = full.rig_from_target.clone();
    let Some(placed) = unless_unseen(place_frames(&tested, &scene, options))? else {
        return Ok(Sums::default());
    };
    let mut sums = judge(&tested, &placed);
    sums.transfer = unless_unseen(transfer(&tested, &scene, options))?.unwrap_or_default();
    Ok(sums)
}

/// Returns `None` in place of the errors of frames that the others' lenses do not see whole, or of too few corners to be
/// placed: they are untested, and the calibration of all frames stands.
fn unless_unseen<T>(found: Result<T, Error>) -> Result<Option<T>, Error> {
    use boresight_adjust::Error as Of;
    match found {
        Err(Error::Adjust(Of::SeedOutOfView { .. } | Of::TooFewEquations { .. })) => Ok(None),
        found => found.map(Some),
    }
}

/// Returns the scene with the frames of `dataset` where its corners say, all else as it is.
pub(crate) fn place_frames(
    dataset: &Dataset,
    scene: &Scene,
    options: &AdjustOptions,
) -> Result<Scene, Error> {
    let (holds, clocks) = (all_but_frames(dataset, scene), Vec::new());
    let options = AdjustOptions { holds, rejection: Rejection::None, clocks, ..options.clone() };
    Ok(optimize(dataset, scene, &options)?.scene)
}

/// Returns what holds everything but where the targets stood.
pub(crate) fn all_but_frames(dataset: &Dataset, scene: &Scene) -> Vec<Hold> {
    let of_camera = |camera| [Hold::Lens(camera), Hold::CamFromRig(camera)];
    let cameras = dataset.cameras.ids().flat_map(of_camera);
    let targets = scene.targets.ids().map(Hold::FirstFromTarget);
    std::iter::once(Hold::Shapes).chain(cameras).chain(targets).collect()
}

/// Sums up the residuals of all views.
fn judge(dataset: &Dataset, scene: &Scene) -> Sums {
    let mut sums = Sums::default();
    let mut frames = BTreeSet::new();
    for view in &dataset.views {
        let Some(seen) = Seen::new(dataset, scene, view) else { continue };
        frames.insert(view.frame);
        sums.n_views += 1;
        for (point, observation) in seen.points_in_cam.iter().zip(&view.observations) {
            let Some(pixel) = seen.camera.project(point) else { continue };
            let square = square([pixel[0] - observation.pixel[0], pixel[1] - observation.pixel[1]]);
            sums.n_observations += 1;
            sums.square_px2 += square;
            sums.chi2 += square / (observation.sigma_px * observation.sigma_px);
            let own = sums.cameras.entry(view.camera).or_default();
            own.0 += square;
            own.1 += 1;
        }
    }
    sums.n_frames = frames.len();
    sums
}

/// Predicts each camera's view of a frame from each other camera's alone.
pub(crate) fn transfer(
    dataset: &Dataset,
    scene: &Scene,
    options: &AdjustOptions,
) -> Result<(usize, f64, f64), Error> {
    let cameras: BTreeSet<CameraId> = dataset.views.iter().map(|view| view.camera).collect();
    let mut sums = (0, 0.0, 0.0);
    if cameras.len() < 2 {
        return Ok(sums);
    }
    for &from in &cameras {
        let own = with_views(dataset, |view| view.camera == from && view.observations.len() >= 6);
        if own.views.is_empty() {
            continue;
        }
        let frames: BTreeSet<FrameId> = own.views.iter().map(|view| view.frame).collect();
        let placed = place_frames(&own, scene, options)?;
        for view in dataset.views.iter().filter(|view| view.camera != from && frames.contains(&view.frame)) {
            let Some(seen) = Seen::new(dataset, &placed, view) else { continue };
            for (point, observation) in seen.points_in_cam.iter().zip(&view.observations) {
                let (Some(pixel), Some(ray)) =
                    (seen.camera.project(point), seen.camera.unproject(observation.pixel))
                else {
                    continue;
                };
                let pixels = [pixel[0] - observation.pixel[0], pixel[1] - observation.pixel[1]];
                // The part of the point that is square to the line of sight.
                let off_ray = point - ray * ray.dot(point);
                sums.0 += 1;
                sums.1 += square(pixels);
                sums.2 += off_ray.norm_squared();
            }
        }
    }
    Ok(sums)
}

/// Where a view's points are in its camera's frame, as a scene believes.
pub(crate) struct Seen<'a> {
    pub camera: &'a boresight_camera::Camera,
    pub points_in_cam: Vec<boresight_geometry::Vector3<f64>>,
}

impl<'a> Seen<'a> {
    pub(crate) fn new(dataset: &Dataset, scene: &'a Scene, view: &View) -> Option<Self> {
        let camera = scene.rig.cameras.get(view.camera)?.as_ref()?;
        // All rows of a global shutter, and the middle one of any other.
        let cam_from_first = scene.cam_from_first(view.camera, view.frame)?;
        let belief = scene.targets.get(view.target)?;
        let first_from_target =
            if view.target == TargetId(0) { Pose::identity() } else { belief.first_from_target };
        let target = dataset.targets.get(view.target)?;
        let in_cam = |observation: &Observation| {
            let cam_from_first = match camera.line_delay_s {
                0.0 => cam_from_first,
                _ => scene.cam_from_first_at_row(view.camera, view.frame, observation.pixel[1])?,
            };
            let point = target.point(observation.point, &belief.shape_m);
            Some(cam_from_first * first_from_target * point)
        };
        let points_in_cam = view.observations.iter().map(in_cam).collect::<Option<Vec<_>>>()?;
        Some(Self { camera: &camera.camera, points_in_cam })
    }
}

fn square([u, v]: [f64; 2]) -> f64 {
    u * u + v * v
}

/// Returns the cameras that a dataset determines relative to the reference: with enough views, and
/// connected to it by frames that they share.
fn determined_cameras(training: &Dataset, scene: &Scene) -> BTreeSet<CameraId> {
    let mut by_frame: BTreeMap<FrameId, BTreeSet<CameraId>> = BTreeMap::new();
    let mut n_views: BTreeMap<CameraId, usize> = BTreeMap::new();
    for view in &training.views {
        by_frame.entry(view.frame).or_default().insert(view.camera);
        *n_views.entry(view.camera).or_default() += 1;
    }
    let has_enough = |camera: &CameraId| n_views.get(camera).is_some_and(|n| *n >= LEAST_VIEWS);
    let mut reached: BTreeSet<CameraId> = scene.rig.reference().into_iter().filter(has_enough).collect();
    loop {
        let before = reached.len();
        for cameras in by_frame.values() {
            if cameras.iter().any(|camera| reached.contains(camera)) {
                reached.extend(cameras.iter().filter(|camera| has_enough(camera)));
            }
        }
        if reached.len() == before {
            return reached;
        }
    }
}

/// Returns the dataset with only some of its views; ids stay as they are.
pub(crate) fn with_views(dataset: &Dataset, is_in: impl Fn(&View) -> bool) -> Dataset {
    Dataset {
        cameras: dataset.cameras.clone(),
        targets: dataset.targets.clone(),
        frames: dataset.frames.clone(),
        views: dataset.views.iter().filter(|view| is_in(view)).cloned().collect(),
    }
}

/// Returns the dataset without the observations that the calibration rejected, and without views of
/// which nothing is left or whose pose it does not know.
pub(crate) fn without_rejected(dataset: &Dataset, calibration: &Calibration) -> Dataset {
    let rejected: BTreeSet<(usize, PointId)> =
        calibration.rejected.iter().map(|rejection| (rejection.view_idx, rejection.point)).collect();
    let mut kept = with_views(dataset, |_| false);
    for (view_idx, view) in dataset.views.iter().enumerate() {
        let is_known = calibration.scene.rig.cameras.get(view.camera).is_some_and(Option::is_some)
            && calibration.scene.rig_from_target.get(view.frame).is_some_and(Option::is_some);
        let observations: Vec<_> = view
            .observations
            .iter()
            .filter(|observation| is_known && !rejected.contains(&(view_idx, observation.point)))
            .copied()
            .collect();
        if !observations.is_empty() {
            kept.views.push(View { observations, ..view.clone() });
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Instant;

    use boresight_adjust::adjust;
    use boresight_io::{JobOverrides, load_job};
    use boresight_synthetic::{Recipe, simulate};

    use super::*;
    use crate::{CalibrateOptions, Watch, calibrate};

    /// Checks what is held out of a synthetic rig whose residuals are noise alone.
    fn check_noise(recipe: Recipe, choice: HoldoutChoice, folds: usize) -> HeldOut {
        let made = simulate(&recipe, 3);
        let options = AdjustOptions { rejection: Rejection::None, ..AdjustOptions::default() };
        let calibration = adjust(&made.dataset, &made.truth, &options, None).unwrap();
        let found = held_out(&made.dataset, &calibration, &options, choice).unwrap().unwrap();
        assert_eq!((found.folds, found.untested_views), (folds, 0));
        assert_eq!(found.observations, made.dataset.observation_count());
        // Without the six degrees of freedom of each pose this would be several percent below one.
        assert!((0.99..1.06).contains(&found.ratio), "{found:?}");
        assert!((found.rms_px / found.in_sample_rms_px / found.ratio - 1.0).abs() < 1e-6, "{found:?}");
        found
    }

    #[test]
    fn noise_alone_gives_a_ratio_of_one() {
        let mono = check_noise(Recipe::mono(), HoldoutChoice::Auto, 20);
        assert_eq!(mono.transfer, None);
        let stereo = check_noise(Recipe::stereo(), HoldoutChoice::Folds(5), 5);
        let transfer = stereo.transfer.as_ref().unwrap();
        // A pose from one camera's corners adds its own noise, not more than about as much again.
        let noise_px = stereo.rms_px;
        assert!(transfer.rms_px > noise_px && transfer.rms_px < 3.0 * noise_px, "{stereo:?}");
        assert!(transfer.rms_mm > 0.0 && transfer.observations > 500, "{stereo:?}");
    }

    #[test]
    fn a_lens_that_does_not_fit_is_worse_on_unseen_frames() {
        // One frame comes from another lens, which the others do not foretell.
        let mut made = simulate(&Recipe::mono(), 3);
        for view in made.dataset.views.iter_mut().filter(|view| view.frame.0 == 7) {
            for observation in &mut view.observations {
                let [u, v] = observation.pixel.map(|pixel| pixel / 1000.0 - 0.7);
                observation.pixel[0] += 40.0 * u * v;
                observation.pixel[1] += 40.0 * u * u;
            }
        }
        let options = AdjustOptions { rejection: Rejection::None, ..AdjustOptions::default() };
        let calibration = adjust(&made.dataset, &made.truth, &options, None).unwrap();
        let found = held_out(&made.dataset, &calibration, &options, HoldoutChoice::Auto).unwrap().unwrap();
        assert!(found.ratio > 1.02, "{found:?}");
    }

    #[test]
    fn it_is_off_where_it_is_switched_off_or_has_nothing_to_leave_out() {
        let made = simulate(&Recipe::mono(), 3);
        let options = AdjustOptions::default();
        let calibration = adjust(&made.dataset, &made.truth, &options, None).unwrap();
        let off = held_out(&made.dataset, &calibration, &options, HoldoutChoice::Off).unwrap();
        assert_eq!(off, None);
        let single = with_views(&made.dataset, |view| view.frame == FrameId(0));
        assert_eq!(held_out(&single, &calibration, &options, HoldoutChoice::Auto).unwrap(), None);
    }

    #[test]
    fn the_recorded_pair_costs_less_than_ten_solves() {
        let dataset = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets/opencv-stereo");
        let job = load_job(&[dataset], &JobOverrides::default()).unwrap();
        let options = CalibrateOptions {
            holdout: HoldoutChoice::Off,
            jobs: 1,
            ..CalibrateOptions::of_job(&job).unwrap()
        };
        let least = |work: &mut dyn FnMut()| {
            let times = (0..7).map(|_| {
                let begin = Instant::now();
                work();
                begin.elapsed().as_secs_f64()
            });
            times.fold(f64::INFINITY, f64::min)
        };
        let mut outcome = None;
        let one = least(&mut || outcome = Some(calibrate(&job, &options, &Watch::default()).unwrap()));
        let outcome = outcome.unwrap();
        let adjust_options = options.adjust_options(&outcome.dataset);
        let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let mut found = None;
        let all = least(&mut || {
            found = single.install(|| {
                held_out(&outcome.dataset, &outcome.calibration, &adjust_options, HoldoutChoice::Auto)
                    .unwrap()
            });
        });
        let found = found.unwrap();
        println!(
            "one solve {:.2} ms, held out {:.2} ms: {:.2} times; {found:?}",
            1e3 * one,
            1e3 * all,
            all / one
        );
        assert_eq!((found.folds, found.frames, found.untested_views), (13, 13, 0));
        assert!((0.9..1.25).contains(&found.ratio), "{found:?}");
        assert!(all <= 10.0 * one, "{all} s against {one} s");
    }
}
