//! Where targets stood in the frames of a dataset, for cameras that are known.

use boresight_data::{Dataset, FrameId, IdVec, Scene};
use boresight_geometry::Pose;

use crate::resection::{Resection, resect};
use crate::sighting::Sighting;

/// A view needs so many points.
const LEAST_POINTS: usize = 6;

/// Residuals of a known lens are about so many sigmas long, if sigmas are honest; more only costs tries.
const TYPICAL_SIGMAS: f64 = 1.0;

/// Returns the scene with the poses of the dataset's frames, each from the view of it that its pose
/// explains best; `None` where no view tells. Lenses, rig and targets stay as they are.
///
/// The scene's cameras and targets are those of the dataset, by id; it may know other frames.
pub fn place(dataset: &Dataset, scene: &Scene) -> Scene {
    let mut best: Vec<Option<(f64, Pose)>> = vec![None; dataset.frames.len()];
    for (view_idx, view) in dataset.views.iter().enumerate() {
        let Some(camera) = scene.rig.cameras.get(view.camera).and_then(Option::as_ref) else { continue };
        let (Some(target), Some(belief)) = (dataset.targets.get(view.target), scene.targets.get(view.target))
        else {
            continue;
        };
        let Ok(sighting) = Sighting::new(view_idx, view, target, LEAST_POINTS) else { continue };
        let Some(Resection { cam_from_target, median, .. }) =
            resect(&camera.camera, &sighting, None, TYPICAL_SIGMAS)
        else {
            continue;
        };
        let rig_from_first =
            camera.cam_from_rig.inverse() * cam_from_target * belief.first_from_target.inverse();
        // Few points are met well by any pose.
        let score = median / (view.observations.len() as f64).sqrt();
        let frame: FrameId = view.frame;
        let best = &mut best[frame.0 as usize];
        if best.is_none_or(|(known, _)| score < known) {
            *best = Some((score, rig_from_first));
        }
    }
    Scene {
        rig_from_target: best.into_iter().map(|found| found.map(|(_, pose)| pose)).collect(),
        motion: IdVec::default(),
        ..scene.clone()
    }
}
