//! Where the target is held, and which of its points a camera sees.

use boresight_camera::Camera;
use boresight_data::{PointId, Target};
use boresight_geometry::nalgebra::Unit;
use boresight_geometry::{Pose, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use crate::Placement;

/// Draws a pose that has the target's centre in view of `camera`; `None` if the pixel drawn sees nothing.
pub(crate) fn draw_pose(
    rng: &mut ChaCha8Rng,
    camera: &Camera,
    placement: &Placement,
    centre_in_target: &Vector3<f64>,
) -> Option<Pose> {
    // All numbers are drawn before anything can fail, so that a failure does not shift what follows.
    let [across, down]: [f64; 2] = rng.random();
    let [distance, tilt, about, roll]: [f64; 4] = rng.random();
    let pixel = [(0, across), (1, down)].map(|(axis, share)| {
        let size = f64::from(camera.image_size[axis]);
        0.5 * (size - 1.0) + (share - 0.5) * placement.image_share * size
    });
    let ray = camera.unproject(pixel)?;
    let [near, far] = placement.distance_m;
    let centre_in_cam = ray * (near + distance * (far - near));

    // The target faces the camera along the line of sight, then is tilted and rolled.
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &ray).unwrap_or_default();
    let angle = about * std::f64::consts::TAU;
    let tilt_axis = Unit::new_normalize(Vector3::new(angle.cos(), angle.sin(), 0.0));
    let tilted = UnitQuaternion::from_axis_angle(&tilt_axis, tilt * placement.tilt_rad);
    let rolled = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), (2.0 * roll - 1.0) * placement.roll_rad);
    let rotation = facing * tilted * rolled;
    Some(Pose::new(rotation, centre_in_cam - rotation * centre_in_target))
}

/// Returns the middle of the target's points.
pub(crate) fn centre_of(target: &Target) -> Vector3<f64> {
    let n = target.point_count().max(1);
    points_of(target).map(|point| target.drawn_point(point)).sum::<Vector3<f64>>() / n as f64
}

/// Returns the points of a target in order.
pub(crate) fn points_of(target: &Target) -> impl Iterator<Item = PointId> + use<> {
    (0..u32::try_from(target.point_count()).unwrap_or(u32::MAX)).map(PointId)
}

/// Returns where `camera` sees each point that is in its image and not seen from behind.
pub(crate) fn visible_points(
    camera: &Camera,
    cam_from_target: &Pose,
    target: &Target,
    shape_m: &[f64],
) -> Vec<(PointId, [f64; 2])> {
    let normal_in_cam = cam_from_target.rotation * Vector3::z();
    // Beyond this angle a lens polynomial folds back and would show what no lens shows.
    let limit_rad = camera.monotonic_limit().unwrap_or(f64::INFINITY);
    let is_board = points_of(target).all(|point| target.drawn_point(point).z == 0.0);
    let size = camera.image_size.map(f64::from);
    let seen = |point: PointId| {
        let point_in_cam = *cam_from_target * target.point(point, shape_m);
        let off_axis_rad = point_in_cam.xy().norm().atan2(point_in_cam.z);
        if off_axis_rad >= limit_rad || (is_board && normal_in_cam.dot(&point_in_cam) <= 0.0) {
            return None;
        }
        let pixel = camera.project(&point_in_cam)?;
        let is_inside = (0..2).all(|axis| pixel[axis] >= -0.5 && pixel[axis] <= size[axis] - 0.5);
        is_inside.then_some((point, pixel))
    };
    points_of(target).filter_map(seen).collect()
}
