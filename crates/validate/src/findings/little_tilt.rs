//! Boards that were all held the same way.

use boresight_data::{CameraId, Severity};
use boresight_geometry::Vector3;

use super::case::{Case, normal_in_target};
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The spread of the boards' orientations in degrees below which focal length and distance part badly.
const CAUTION_BELOW_DEG: f64 = 15.0;

/// Boards that were all held the same way.
pub(super) struct LittleTilt;

impl Diagnostic for LittleTilt {
    const CODE: &'static str = "little-tilt";

    const EXPLANATION: &'static str = "\
What it means: the normals of the boards, seen from this camera, differ by less
than 15 degrees between any two views: all boards were nearly parallel. Turning
a board in its own plane does not change its normal.

Why it matters: parallel boards cannot tell a longer focal length from a larger
distance, nor the principal point from a shift of the board. Both make the same
picture, so the residuals are small and the focal length is still wrong, by
several percent and often far more. Only perspective tells them apart: the near
side of a tilted board is larger than its far side.

How to fix it: take views with the board tilted by 20 to 45 degrees about its
horizontal axis, and others about its vertical axis, to both sides. Half of all
views should be tilted. If board and camera cannot be turned against each other,
hold the focal length at a known value.";

    fn find(case: &Case) -> Vec<Found> {
        let estimated = case.cameras().filter(|(_, name, _)| !case.lens_is_held(name));
        let found = estimated.filter_map(|(id, name, _)| {
            let spread_deg = spread_of_normals(case, id)?.to_degrees();
            (spread_deg < CAUTION_BELOW_DEG).then(|| Found {
                severity: Severity::Caution,
                place: name.to_owned(),
                message: format!("the boards' orientations differ by at most {spread_deg:.1} degrees"),
                measured: Some(spread_deg),
                limit: Some(CAUTION_BELOW_DEG),
                fix: "Take views with the board tilted by 20 to 45 degrees about either axis.".to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        use boresight_synthetic::{Placement, Recipe};

        let flat = Recipe::mono();
        let placement = Placement { tilt_rad: 0.02, image_share: 0.1, ..flat.placement };
        vec![(Example::of(Recipe { placement, ..flat }), Severity::Caution)]
    }
}

/// Returns the largest angle in radians between the normals of any two boards that a camera saw, or
/// `None` if it saw fewer than two, or a target that is not flat.
pub(crate) fn spread_of_normals(case: &Case, camera: CameraId) -> Option<f64> {
    let mut normals: Vec<Vector3<f64>> = Vec::new();
    for used in case.used_views_of(camera) {
        let normal = normal_in_target(case.target(used.view)?)?;
        if let Some(cam_from_target) = case.cam_from_target(used.view) {
            normals.push(cam_from_target.rotation * normal);
        }
    }
    if normals.len() < 2 {
        return None;
    }
    // A normal and its negative are the same plane.
    let mut least_cosine: f64 = 1.0;
    for (i, one) in normals.iter().enumerate() {
        for other in &normals[i + 1..] {
            least_cosine = least_cosine.min(one.dot(other).abs());
        }
    }
    Some(least_cosine.acos())
}

#[cfg(test)]
mod tests {
    use boresight_geometry::Pose;

    use super::*;

    #[test]
    fn a_common_tilt_and_a_roll_are_no_spread() {
        let mut example = Example::mono();
        let mut roll = 0.0;
        for pose in example.calibration.scene.rig_from_target.iter_mut() {
            let turn = |v: Vector3<f64>| Pose::from_rodrigues(v, Vector3::zeros());
            let tilted = turn(Vector3::x() * 0.5) * turn(Vector3::z() * roll);
            *pose = Some(Pose::new(tilted.rotation, Vector3::new(0.0, 0.0, 1.0)));
            roll += 0.1;
        }
        let case = Case::new(&example.dataset, &example.calibration);
        let spread = spread_of_normals(&case, CameraId(0)).unwrap();
        // The angle of an arc cosine near one is good to the root of the precision.
        assert!(spread < 1e-7, "{spread}");
        assert_eq!(spread_of_normals(&case, CameraId(1)), None);
    }
}
