//! What is wrong with a recording, before any solve.
//!
//! Reading and detection have told what they noticed. A start, in closed form, tells which views go together, where the
//! boards stood and how far the lens reaches; what is doubtful about that is found as it is found in a calibration.

use boresight_camera::{Camera, Model};
use boresight_data::{
    Calibration, Dataset, Finding, Rejection, RejectionReason, Rig, RigCamera, Scene, Severity, Shape, View,
    ViewFit,
};
use boresight_geometry::Pose;
use boresight_io::Job;
use boresight_seed::{LeftOut, SeedOptions, seed};
use boresight_validate::{Looks, findings_before, looks};

use crate::calibrate::known_lenses;
use crate::choices::LensModel;
use crate::error::Error;
use crate::held_out::Seen;
use crate::options::CalibrateOptions;
use crate::select::select_cameras;

/// The code of the finding that there is no start.
pub(crate) const NO_START: &str = "no-start";

/// What a look at a job came to.
#[derive(Clone, Debug)]
pub struct Examination {
    /// The cameras that were looked at, and what they saw.
    pub dataset: Dataset,
    /// The same in numbers.
    pub looks: Looks,
    /// What is doubtful, the gravest first; what was noticed while reading is among it.
    pub findings: Vec<Finding>,
}

impl Examination {
    /// Tells whether it can be calibrated as it is: nothing that was found is a [`Severity::Fail`].
    pub fn is_usable(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity != Severity::Fail)
    }
}

/// Looks at a job without solving it. Of the options, cameras and lens models count; a lens that is to be chosen is
/// `opencv5` here.
pub fn examine(job: &Job, options: &CalibrateOptions) -> Result<Examination, Error> {
    let mut dataset = select_cameras(&job.dataset, &options.cameras)?;
    options.model.check_names(&dataset)?;
    dataset.targets.iter_mut().for_each(|target| target.shape = Shape::Rigid);
    let model = |name: &str| match options.model.of(name) {
        LensModel::Given(model) => model,
        LensModel::Auto => Model::OpenCv5(Default::default()),
    };
    let models = dataset.cameras.iter().map(|camera| model(&camera.name)).collect();
    let known = known_lenses(job, &dataset);
    let seed_options = SeedOptions { models, known, ..SeedOptions::default() };
    let (start, no_start) = match seed(&dataset, &seed_options) {
        Ok(seed) => (start_of(&dataset, seed.scene, &seed.left_out), None),
        Err(error) => (without_start(&dataset), Some(Error::from(error))),
    };
    let mut findings = findings_before(&dataset, &start);
    if let Some(error) = no_start {
        findings.push(Finding {
            code: NO_START.to_owned(),
            severity: Severity::Fail,
            place: "all views".to_owned(),
            message: error.to_string(),
            measured: None,
            limit: None,
            fix: error.hint().unwrap_or_else(|| {
                "Take more views, tilted by 20 to 45 degrees to either side, and check the target's size."
                    .to_owned()
            }),
        });
    }
    findings.extend(job.findings.iter().cloned());
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    Ok(Examination { looks: looks(&dataset, &start), dataset, findings })
}

/// Returns a start in the form of a calibration: what it could use has residuals, the rest its reason.
fn start_of(dataset: &Dataset, scene: Scene, left_out: &[LeftOut]) -> Calibration {
    let mut rejected = Vec::new();
    let mut views = Vec::new();
    for (view_idx, view) in dataset.views.iter().enumerate() {
        let why = left_out.iter().find(|fact| match fact {
            LeftOut::TooFewViews { camera, .. }
            | LeftOut::NoLens { camera, .. }
            | LeftOut::Unconnected { camera, .. } => *camera == view.camera,
            fact => fact.view_idx() == Some(view_idx),
        });
        let residuals_px = if why.is_none() { residuals_px(dataset, &scene, view) } else { None };
        if residuals_px.is_none() {
            let why =
                why.map_or_else(|| "a start does not reach it".to_owned(), |fact| fact.describe(dataset));
            let reason = RejectionReason::LeftOut { why };
            let each = view.observations.iter();
            rejected.extend(each.map(|observation| Rejection {
                view_idx,
                point: observation.point,
                reason: reason.clone(),
            }));
        }
        views.push(ViewFit {
            rms_px: residuals_px.as_ref().and_then(|residuals| {
                let square: f64 = residuals.iter().flatten().map(|r| r * r).sum();
                (!residuals.is_empty()).then(|| (square / residuals.len() as f64).sqrt())
            }),
            residuals_px: residuals_px.unwrap_or_default(),
        });
    }
    Calibration { views, rejected, ..shell(dataset, scene) }
}

/// Returns predicted minus observed pixels of a view, or `None` if a start does not reach it.
fn residuals_px(dataset: &Dataset, scene: &Scene, view: &View) -> Option<Vec<[f64; 2]>> {
    let seen = Seen::new(dataset, scene, view)?;
    let pairs = seen.points_in_cam.iter().zip(&view.observations);
    pairs
        .map(|(point, observation)| {
            let predicted = seen.camera.project(point)?;
            Some([0, 1].map(|axis| predicted[axis] - observation.pixel[axis]))
        })
        .collect()
}

/// Returns what can be told where there is no start: where corners were seen in images, and in which together.
fn without_start(dataset: &Dataset) -> Calibration {
    let camera = |info: &boresight_data::CameraInfo| {
        let [width, height] = info.image_size.map(f64::from);
        // Any lens that reaches the whole image will do: poses are not asked for.
        let params = vec![width, width, 0.5 * (width - 1.0), 0.5 * (height - 1.0)];
        let camera = Camera::new(Model::Pinhole(Default::default()), params, info.image_size).ok()?;
        Some(RigCamera::new(camera, Pose::identity()))
    };
    let scene = Scene {
        rig: Rig { cameras: dataset.cameras.iter().map(camera).collect() },
        rig_from_target: dataset.frames.iter().map(|_| None).collect(),
        ..Scene::default()
    };
    let seen =
        |view: &View| ViewFit { rms_px: Some(0.0), residuals_px: vec![[0.0; 2]; view.observations.len()] };
    Calibration { views: dataset.views.iter().map(seen).collect(), ..shell(dataset, scene) }
}

/// Returns a calibration in which nothing but the scene is said.
fn shell(dataset: &Dataset, scene: Scene) -> Calibration {
    let camera_names = dataset.cameras.iter().map(|info| info.name.clone());
    Calibration {
        targets: dataset.targets.clone(),
        frame_names: dataset.frames.iter().map(|frame| frame.name.clone()).collect(),
        ..Calibration::unsolved(scene, camera_names, "nothing was solved")
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::CameraId;
    use boresight_synthetic::{Placement, Recipe, simulate};

    use super::*;

    fn examined(dataset: Dataset) -> Examination {
        examine(&Job::from(dataset), &CalibrateOptions::default()).unwrap()
    }

    #[track_caller]
    fn check(dataset: Dataset, expected: &[(&str, Severity, &str)]) -> Examination {
        let found = examined(dataset);
        let codes: Vec<(&str, Severity, &str)> = (found.findings.iter())
            .map(|finding| (finding.code.as_str(), finding.severity, finding.place.as_str()))
            .collect();
        assert_eq!(codes, expected, "{:?}", found.findings);
        found
    }

    fn good() -> Recipe {
        Recipe { frames: 40, ..Recipe::stereo() }
    }

    #[test]
    fn a_good_recording_has_no_findings() {
        for recipe in [good(), Recipe { frames: 40, ..Recipe::mono() }] {
            let found = check(simulate(&recipe, 7).dataset, &[]);
            for look in &found.looks.cameras {
                assert!(look.coverage.is_some_and(|share| share > 0.6), "{look:?}");
                assert!(look.tilt_spread_rad.is_some_and(|spread| spread > 0.5), "{look:?}");
                assert!(look.largest_board.is_some_and(|share| share > 0.3), "{look:?}");
                assert_eq!(look.sigma_px, None, "simulated sigmas are stated");
            }
        }
        let weakest = check(simulate(&good(), 7).dataset, &[]).looks.weakest_link.unwrap();
        assert_eq!(weakest.cameras, [CameraId(1)]);
        assert!(weakest.frames > 20, "{weakest:?}");
    }

    #[test]
    fn boards_that_are_all_parallel_are_told() {
        let mut recipe = Recipe { frames: 40, ..Recipe::mono() };
        recipe.placement = Placement { tilt_rad: 0.02, image_share: 0.1, ..recipe.placement };
        let found = examined(simulate(&recipe, 3).dataset);
        let codes: Vec<&str> = found.findings.iter().map(|finding| finding.code.as_str()).collect();
        assert!(codes.contains(&"little-tilt"), "{:?}", found.findings);
    }

    #[test]
    fn too_few_views_are_told_although_there_is_no_start() {
        let mut dataset = simulate(&good(), 7).dataset;
        dataset.views.retain(|view| view.frame.0 < 2);
        let found = examined(dataset);
        let codes: Vec<&str> = found.findings.iter().map(|finding| finding.code.as_str()).collect();
        assert!(codes.contains(&"no-start") && codes.contains(&"few-views"), "{:?}", found.findings);
        assert_eq!(found.findings[0].severity, Severity::Fail);
    }

    #[test]
    fn a_model_of_a_camera_that_is_not_there_is_refused() {
        let options = CalibrateOptions { model: "opencv5,left=eucm".parse().unwrap(), ..Default::default() };
        let refused = examine(&Job::from(simulate(&good(), 7).dataset), &options).unwrap_err();
        assert!(matches!(&refused, Error::UnknownCamera { name, .. } if name == "left"), "{refused}");
    }

    #[test]
    fn cameras_that_share_no_frame_are_told() {
        let mut dataset = simulate(&good(), 7).dataset;
        dataset.views.retain(|view| view.frame.0 % 2 == view.camera.0);
        let found = examined(dataset);
        let told = found.findings.iter().any(|finding| {
            ["left-out", "weak-rig-link"].contains(&finding.code.as_str())
                && finding.severity >= Severity::Caution
        });
        assert!(told, "{:?}", found.findings);
    }

    #[test]
    fn a_mirrored_camera_is_told() {
        let mut dataset = simulate(&good(), 7).dataset;
        let width = f64::from(dataset.cameras[CameraId(1)].image_size[0]);
        for view in dataset.views.iter_mut().filter(|view| view.camera == CameraId(1)) {
            view.observations
                .iter_mut()
                .for_each(|observation| observation.pixel[0] = width - 1.0 - observation.pixel[0]);
        }
        let found = examined(dataset);
        let first = &found.findings[0];
        let expected = ("mirrored-corners", Severity::Fail, "cam1");
        assert_eq!(
            (first.code.as_str(), first.severity, first.place.as_str()),
            expected,
            "{:?}",
            found.findings
        );
    }

    #[test]
    fn small_boards_and_repeated_frames_are_told() {
        let mut recipe = Recipe { frames: 40, ..Recipe::mono() };
        recipe.placement = Placement { distance_m: [3.0, 4.0], image_share: 0.95, ..recipe.placement };
        let mut dataset = simulate(&recipe, 7).dataset;
        for i in 0..5 {
            let copy = dataset.views[i].observations.clone();
            dataset.views[i + 20].observations = copy;
        }
        let found = examined(dataset);
        for code in ["small-board", "near-identical-frames"] {
            assert!(
                found.findings.iter().any(|finding| finding.code == code),
                "{code}: {:?}",
                found.findings
            );
        }
    }
}
