//! A target that a hand waves while cameras look, each at its own time.

use std::f64::consts::TAU;

use boresight_camera::Camera;
use boresight_data::{CameraId, FrameId, Id as _, PointId};
use boresight_geometry::{Pose, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::Recipe;
use crate::place::{centre_of, visible_points};
use crate::simulate::{Synthetic, dataset_without_views, observe, truth_without_frames};

/// How often a point's row and time are found from each other; a hand moves a target by a few hundredths of a row from row
/// to row.
const ROUNDS: usize = 12;

/// When frames are taken, and how late cameras are.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// The time from frame to frame, in seconds.
    pub period_s: f64,
    /// How long after the frame's time each camera takes its image, in seconds, by index; none is zero.
    pub late_s: Vec<f64>,
    /// How long after the row above it each row of a camera's image is taken, in seconds, by index; none is zero. An image's
    /// time is that of its middle row.
    pub line_delay_s: Vec<f64>,
    /// How fast the target is waved: at one, a hand goes to and fro in three seconds or so.
    pub speed: f64,
}

/// Simulates a recipe whose target is waved in front of the rig; its placement has no say but for the distance.
///
/// The truth's pose of a frame is that at the frame's time. A camera whose image has enough points in it has a view.
pub fn simulate_moving(recipe: &Recipe, timing: &Timing, seed: u64) -> Synthetic {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut made = Synthetic {
        truth: truth_without_frames(recipe),
        dataset: dataset_without_views(recipe),
        clean_px: Vec::new(),
        outliers: Vec::new(),
    };
    let of = |times_s: &[f64], camera: CameraId| times_s.get(camera.index()).copied().unwrap_or(0.0);
    for camera in made.dataset.cameras.ids() {
        if let Some(camera_of_truth) = &mut made.truth.rig.cameras[camera] {
            camera_of_truth.time_offset_s = of(&timing.late_s, camera);
            camera_of_truth.line_delay_s = of(&timing.line_delay_s, camera);
        }
    }
    for frame in (0..recipe.frames).map(FrameId::from_index) {
        let time_s = frame.index() as f64 * timing.period_s;
        made.dataset.frames[frame].time_ns = Some((time_s * 1e9).round() as i64);
        made.truth.rig_from_target.push(Some(waved(recipe, timing.speed * time_s)));
        for (camera, placed) in (0..).map(CameraId::from_index).zip(&recipe.cameras) {
            let Some(camera_of_truth) = &made.truth.rig.cameras[camera] else { continue };
            let cam_from_target =
                |late_s: f64| placed.cam_from_rig * waved(recipe, timing.speed * (time_s + late_s));
            let late_s = camera_of_truth.time_offset_s;
            let middle = cam_from_target(late_s);
            let mut seen = visible_points(&placed.camera, &middle, &recipe.target, &recipe.shape_m);
            if camera_of_truth.line_delay_s != 0.0 {
                seen = rolled(recipe, &placed.camera, seen, |v_px| {
                    cam_from_target(camera_of_truth.late_s(v_px))
                });
            }
            if seen.len() >= recipe.min_points.max(1) {
                observe(&mut rng, recipe, &mut made, camera, frame, seen);
            }
        }
    }
    made
}

/// Returns where points are seen that move while the rows are taken, from where they are seen at the middle row's time;
/// those that have left the image by then are not seen.
fn rolled(
    recipe: &Recipe,
    camera: &Camera,
    mut seen: Vec<(PointId, [f64; 2])>,
    cam_from_target: impl Fn(f64) -> Pose,
) -> Vec<(PointId, [f64; 2])> {
    let size = camera.image_size.map(f64::from);
    seen.retain_mut(|(point, pixel)| {
        let point_in_target = recipe.target.point(*point, &recipe.shape_m);
        // The row tells the time and the time the row: each round is nearer by what the target moves from row to row, in rows.
        for _ in 0..ROUNDS {
            match camera.project(&(cam_from_target(pixel[1]) * point_in_target)) {
                Some(next) => *pixel = next,
                None => return false,
            }
        }
        (0..2).all(|axis| pixel[axis] >= -0.5 && pixel[axis] <= size[axis] - 0.5)
    });
    seen
}

/// Returns where a hand holds the target at a time: `rig_from_target`, about the middle between all cameras.
fn waved(recipe: &Recipe, time_s: f64) -> Pose {
    // Periods without a common multiple, so that no pose comes again.
    let wave = |period_s: f64, phase: f64| (TAU * time_s / period_s + phase).sin();
    let eyes = recipe.cameras.iter().map(|placed| placed.cam_from_rig.inverse().translation);
    let eye = eyes.sum::<Vector3<f64>>() / recipe.cameras.len().max(1) as f64;
    let [near_m, far_m] = recipe.placement.distance_m;
    let (middle_m, reach_m) = (0.5 * (near_m + far_m), 0.3 * (far_m - near_m));
    let turn = Vector3::new(0.45 * wave(3.1, 0.0), 0.5 * wave(2.7, 1.0), 0.25 * wave(4.3, 2.0));
    let middle = eye
        + Vector3::new(
            0.22 * middle_m * wave(3.7, 0.5),
            0.15 * middle_m * wave(2.9, 1.5),
            middle_m + reach_m * wave(5.3, 0.3),
        );
    let turned = Pose::from_rodrigues(turn, Vector3::zeros());
    Pose::new(turned.rotation, middle - turned * centre_of(&recipe.target))
}
