//! Camera to robot plane: Eqs 8.23 to 8.30 as they stand, for an image plane parallel to the robot's.
//!
//! The image frame's origin is that of the index frame, and pixels become metres by one factor λ. All
//! poses here are turns about one common z axis. A camera that looks down on a robot whose z points
//! up sees the plane from its other side: then [`Facing::Opposite`] puts half a turn about x between
//! the z axes, which the textbook leaves out.

use boresight_geometry::nalgebra::Matrix4;
use boresight_geometry::{Vector2, Vector3};

/// How the z axis of the image frame, which points into the scene, lies to that of the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Facing {
    /// Along it: the textbook's case.
    #[default]
    Same,
    /// Against it: the camera looks down, the robot's z points up.
    Opposite,
}

impl Facing {
    /// Returns +1 for the same direction and -1 for the opposite one.
    pub fn sign(self) -> f64 {
        match self {
            Self::Same => 1.0,
            Self::Opposite => -1.0,
        }
    }
}

/// Returns a turn by an angle about z and a shift: the form of Eqs 8.24, 8.26 and 8.28.
pub fn planar_pose(angle_rad: f64, translation_m: [f64; 3]) -> Matrix4<f64> {
    let (sin, cos) = angle_rad.sin_cos();
    let [x, y, z] = translation_m;
    Matrix4::new(cos, -sin, 0.0, x, sin, cos, 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0)
}

/// Returns half a turn about x for cameras that face the robot's z axis, else the identity.
pub fn facing_matrix(facing: Facing) -> Matrix4<f64> {
    let sign = facing.sign();
    Matrix4::new(1.0, 0.0, 0.0, 0.0, 0.0, sign, 0.0, 0.0, 0.0, 0.0, sign, 0.0, 0.0, 0.0, 0.0, 1.0)
}

/// Returns a position in the image frame, in metres, of a pixel: Eqs 8.25 and 8.29.
pub fn position_in_image_m(lambda_m_per_px: f64, pixel: [f64; 2]) -> [f64; 2] {
    pixel.map(|x| lambda_m_per_px * x)
}

/// Returns the pose of a pattern or an object in the image frame, `iHcp` or `iHo`, from its angle and
/// the pixel of its origin: Eqs 8.24 with 8.25, and 8.28 with 8.29.
pub fn pose_in_image(angle_rad: f64, lambda_m_per_px: f64, pixel: [f64; 2]) -> Matrix4<f64> {
    let [x, y] = position_in_image_m(lambda_m_per_px, pixel);
    planar_pose(angle_rad, [x, y, 0.0])
}

/// Returns the pose of the image frame in the robot's, `Hi = Hcp iHcp⁻¹`: Eq. 8.27, from Eq. 8.23.
///
/// `None` if `iHcp` has no inverse.
pub fn image_in_robot(
    pattern_in_robot: &Matrix4<f64>,
    pattern_in_image: &Matrix4<f64>,
) -> Option<Matrix4<f64>> {
    Some(pattern_in_robot * pattern_in_image.try_inverse()?)
}

/// Returns the pose of an object in the robot's frame, `Ho = Hi iHo`: Eq. 8.30.
pub fn object_in_robot(image_in_robot: &Matrix4<f64>, object_in_image: &Matrix4<f64>) -> Matrix4<f64> {
    image_in_robot * object_in_image
}

/// A pattern in the plane of the robot, found by touching its points: the parts of `Hcp`, Eq. 8.26.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchedPattern {
    /// The turn of the pattern's x axis in radians, `φcp`.
    pub angle_rad: f64,
    /// The pattern's origin in the robot's frame, in metres.
    pub translation_m: [f64; 3],
    /// Touched distances over distances on the pattern. One, unless units or pattern are wrong.
    pub scale: f64,
    /// Touched minus expected position of each point in the plane, in metres, at scale one.
    pub residuals_m: Vec<[f64; 2]>,
}

impl TouchedPattern {
    /// Returns `Hcp`: Eq. 8.26.
    pub fn matrix(&self, facing: Facing) -> Matrix4<f64> {
        planar_pose(self.angle_rad, self.translation_m) * facing_matrix(facing)
    }
}

/// Returns the pose of the pattern from two or more of its points, touched: Eq. 8.26 by least squares, with
/// the mean of the heights as `zcp`. `None` if all points coincide, or there are fewer than two.
///
/// A pattern that is [`Facing::Opposite`] has its own y axis mirrored in the robot's plane.
pub fn touched_pattern(
    points_in_pattern_m: &[[f64; 2]],
    touched_m: &[[f64; 3]],
    facing: Facing,
) -> Option<TouchedPattern> {
    let n = points_in_pattern_m.len().min(touched_m.len());
    let sign = facing.sign();
    let pattern: Vec<Vector2<f64>> =
        points_in_pattern_m[..n].iter().map(|&[x, y]| Vector2::new(x, sign * y)).collect();
    let touched: Vec<Vector3<f64>> = touched_m[..n].iter().map(|&touch| Vector3::from(touch)).collect();
    let from = pattern.iter().sum::<Vector2<f64>>() / n as f64;
    let onto = touched.iter().sum::<Vector3<f64>>() / n as f64;
    let (mut dot, mut cross, mut square) = (0.0, 0.0, 0.0);
    for (p, t) in pattern.iter().zip(&touched) {
        let (p, t) = (p - from, (t - onto).xy());
        dot += p.dot(&t);
        cross += p.x * t.y - p.y * t.x;
        square += p.norm_squared();
    }
    // NaN for no points at all.
    let length = dot.hypot(cross);
    // Points that coincide are apart by rounding only.
    let rounding = 1e-24 * n as f64 * from.norm_squared();
    let is_spread = square > rounding && length > 0.0;
    if !is_spread {
        return None;
    }
    let (cos, sin) = (dot / length, cross / length);
    let turned = |p: &Vector2<f64>| Vector2::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y);
    let origin = onto.xy() - turned(&from);
    let residuals_m =
        pattern.iter().zip(&touched).map(|(p, t)| (t.xy() - origin - turned(p)).into()).collect();
    Some(TouchedPattern {
        angle_rad: sin.atan2(cos),
        translation_m: [origin.x, origin.y, onto.z],
        scale: length / square,
        residuals_m,
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    /// The chapter's procedure from end to end: λ, iHcp, touches, Hcp, Hi, iHo, Ho.
    fn check(facing: Facing) {
        let lambda = 0.0005;
        let truth = planar_pose(0.7, [0.4, -0.1, 0.02]) * facing_matrix(facing);
        // A pattern turned by 0.2 rad in the image, with its origin at pixel (300, 200).
        let pattern_in_image = pose_in_image(0.2, lambda, [300.0, 200.0]);
        let points = [[0.0, 0.0], [0.12, 0.0], [0.0, 0.08]];
        let touched = points.map(|[x, y]| {
            let point = truth * pattern_in_image * Vector3::new(x, y, 0.0).push(1.0);
            [point.x, point.y, point.z]
        });
        let pattern = touched_pattern(&points, &touched, facing).unwrap();
        assert!((pattern.scale - 1.0).abs() < 1e-14 && (pattern.translation_m[2] - 0.02).abs() < 1e-15);
        assert!(pattern.residuals_m.iter().flatten().all(|residual| residual.abs() < 1e-15));
        let found = image_in_robot(&pattern.matrix(facing), &pattern_in_image).unwrap();
        assert!((found - truth).norm() < 1e-14, "{found} {truth}");
        // An object at (700, 500), turned by a right angle.
        let object = object_in_robot(&found, &pose_in_image(FRAC_PI_2, lambda, [700.0, 500.0]));
        let expected = truth * Vector3::new(0.35, 0.25, 0.0).push(1.0);
        assert!((object.column(3) - expected).norm() < 1e-14);
        let turn = object[(1, 0)].atan2(object[(0, 0)]);
        assert!((turn - (0.7 + facing.sign() * FRAC_PI_2)).abs() < 1e-14, "{turn}");
    }

    #[test]
    fn the_chapters_procedure_finds_the_image_in_the_robot() {
        check(Facing::Same);
        check(Facing::Opposite);
    }

    #[test]
    fn wrong_units_show_in_the_scale_and_a_missed_point_in_its_residual() {
        let points = [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.1]];
        let mut touched = points.map(|[x, y]| [1000.0 * x, 1000.0 * y, 0.0]);
        let pattern = touched_pattern(&points, &touched, Facing::Same).unwrap();
        assert!((pattern.scale - 1000.0).abs() < 1e-9);
        touched = points.map(|[x, y]| [x, y, 0.0]);
        touched[3][0] += 0.004;
        let pattern = touched_pattern(&points, &touched, Facing::Same).unwrap();
        let length = |i: usize| pattern.residuals_m[i][0].hypot(pattern.residuals_m[i][1]);
        assert!(length(3) > 0.002 && (0..3).all(|i| length(i) < length(3)), "{pattern:?}");
        assert_eq!(touched_pattern(&points[..1], &touched[..1], Facing::Same), None);
        assert_eq!(touched_pattern(&[[0.1, 0.2]; 3], &touched[..3], Facing::Same), None);
    }
}
