//! Leave one frame out, solve again, and see how well the frame is foretold from the robot's word alone.

use boresight_data::{Dataset, FrameId, Geometry, Scene, View};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::Threads;

use crate::adjust::optimize;
use crate::error::Error;
use crate::options::AdjustOptions;

/// A frame, and what all others foretell of it.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldOut {
    /// The frame.
    pub frame: FrameId,
    /// The scene that the other frames ask for.
    pub scene: Scene,
    /// How far its observations are from where that scene has them.
    pub errors: SightErrors,
}

/// How far observations are from a prediction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SightErrors {
    /// The distance in metres of each point from where the ray of its pixel meets the target's plane, or
    /// from the ray where the target is not flat or seen edge-on.
    pub distances_m: Vec<f64>,
    /// The distance of each pixel from its prediction.
    pub distances_px: Vec<f64>,
}

/// Leaves out each frame that the robot tells of, in turn, and foretells it from all others.
///
/// `optimum` is the scene of all frames. Observations that are outliers must have been taken out.
pub fn leave_one_out(
    dataset: &Dataset,
    optimum: &Scene,
    options: &AdjustOptions,
) -> Result<Vec<HeldOut>, Error> {
    let told = dataset.frames.enumerate().filter_map(|(frame, info)| Some((frame, info.base_from_flange?)));
    let seen = told.filter(|(frame, _)| dataset.views.iter().any(|view| view.frame == *frame));
    let seen: Vec<(FrameId, Pose)> = seen.collect();
    // Each frame is a solve of its own: threads share out frames.
    let threads = Threads::new(options.threads, seen.len() * 2 * dataset.observation_count())?;
    let options = AdjustOptions { threads: 1, ..options.clone() };
    let foretold = threads.map(seen, |(frame, base_from_flange)| {
        let scene = optimize(&without(dataset, frame), optimum, &options)?.scene;
        let Some(robot) = &scene.robot else { return Ok(None) };
        let rig_from_target = robot.rig_from_target(&robot.corrected(&base_from_flange));
        let mut errors = SightErrors::default();
        for view in dataset.views.iter().filter(|view| view.frame == frame) {
            errors.add(sight_errors(dataset, &scene, view, &rig_from_target));
        }
        Ok(Some(HeldOut { frame, scene, errors }))
    });
    foretold.into_iter().filter_map(Result::transpose).collect()
}

/// Returns the dataset without the views of a frame.
fn without(dataset: &Dataset, frame: FrameId) -> Dataset {
    Dataset {
        cameras: dataset.cameras.clone(),
        targets: dataset.targets.clone(),
        frames: dataset.frames.clone(),
        views: dataset.views.iter().filter(|view| view.frame != frame).cloned().collect(),
    }
}

impl SightErrors {
    /// Appends others.
    pub fn add(&mut self, mut others: Self) {
        self.distances_m.append(&mut others.distances_m);
        self.distances_px.append(&mut others.distances_px);
    }
}

/// Returns how far the observations of a view are from where `rig_from_target` puts the first target.
///
/// A point that the lens cannot see where it should be, or a pixel that no ray belongs to, is infinitely far.
pub fn sight_errors(dataset: &Dataset, scene: &Scene, view: &View, rig_from_target: &Pose) -> SightErrors {
    let mut errors = SightErrors::default();
    let Some(camera) = &scene.rig.cameras[view.camera] else { return errors };
    let (target, belief) = (&dataset.targets[view.target], &scene.targets[view.target]);
    let motion = scene.motion.get(view.frame).copied().flatten();
    let flat = is_flat(&target.geometry);
    for observation in &view.observations {
        // As the camera took the row.
        let late_s = camera.late_s(observation.pixel[1]);
        let moved =
            motion.filter(|_| late_s != 0.0).map_or_else(Pose::identity, |motion| motion.after(late_s));
        let cam_from_target = camera.cam_from_rig * moved * *rig_from_target * belief.first_from_target;
        let normal = flat.then(|| cam_from_target.rotation * Vector3::z());
        let point_in_cam = cam_from_target * target.point(observation.point, &belief.shape_m);
        let distance_m = camera.camera.unproject(observation.pixel).map_or(f64::INFINITY, |ray| {
            let foot = match normal.map(|normal| (normal.dot(&point_in_cam), normal.dot(&ray))) {
                Some((height, slope)) if slope.abs() > 0.05 => ray * (height / slope),
                _ => ray * ray.dot(&point_in_cam) / ray.norm_squared(),
            };
            (foot - point_in_cam).norm()
        });
        errors.distances_m.push(distance_m);
        let distance_px = camera.camera.project(&point_in_cam).map_or(f64::INFINITY, |pixel| {
            (pixel[0] - observation.pixel[0]).hypot(pixel[1] - observation.pixel[1])
        });
        errors.distances_px.push(distance_px);
    }
    errors
}

/// Tells whether a target lies in a plane across its z axis.
fn is_flat(geometry: &Geometry) -> bool {
    match geometry {
        Geometry::Points { points_m } => {
            points_m.iter().all(|point| (point[2] - points_m[0][2]).abs() < 1e-6)
        }
        _ => true,
    }
}
