//! Backward projection with a model: the twelve equations 8.15 and 8.16 as they stand.
//!
//! Solving them for three points is `backward_project` in the crate `boresight-seed`; here they are
//! written down, so that any solution can be held against them.

use boresight_geometry::Point3;
use boresight_geometry::nalgebra::Matrix3x4;

use super::project_by_h;

/// Returns the sides 12, 23 and 31 of a triangle: Eq. 8.16.
pub fn side_lengths(points_in_ref: &[Point3<f64>; 3]) -> [f64; 3] {
    let [a, b, c] = points_in_ref;
    [(a - b).norm(), (b - c).norm(), (c - a).norm()]
}

/// Returns by how much three points fail the equations: the distance of each from its pixel, in pixels
/// (Eq. 8.15), and of each side from its length, in the unit of the points (Eq. 8.16).
///
/// `None` if a point is not in front of the camera.
pub fn backward_misfit(
    h: &Matrix3x4<f64>,
    points_in_ref: &[Point3<f64>; 3],
    pixels: &[[f64; 2]; 3],
    sides: [f64; 3],
) -> Option<([f64; 3], [f64; 3])> {
    let mut missed_px = [0.0; 3];
    for ((missed, point), [u, v]) in missed_px.iter_mut().zip(points_in_ref).zip(pixels) {
        let seen = project_by_h(h, point)?;
        *missed = (seen.u - u).hypot(seen.v - v);
    }
    let found = side_lengths(points_in_ref);
    Some((missed_px, [0, 1, 2].map(|k| found[k] - sides[k])))
}

#[cfg(test)]
mod tests {
    use boresight_geometry::{Pose, Vector3};

    use super::*;
    use crate::textbook::h_matrix;

    #[test]
    fn true_points_fail_no_equation_and_moved_ones_do() {
        let cam_from_ref = Pose::from_rodrigues(Vector3::new(0.2, -0.1, 0.3), Vector3::new(0.0, 0.1, 3.0));
        let h = h_matrix([1000.0, 1010.0, 640.0, 480.0], &cam_from_ref);
        let mut points = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.4, 0.0]].map(Point3::from);
        let pixels = points.map(|point| project_by_h(&h, &point).map(|seen| [seen.u, seen.v]).unwrap());
        let (missed, sides) = backward_misfit(&h, &points, &pixels, [0.3, 0.5, 0.4]).unwrap();
        assert!(missed.iter().chain(&sides).all(|error| error.abs() < 1e-12), "{missed:?} {sides:?}");
        points[1].x += 0.003;
        let (missed, sides) = backward_misfit(&h, &points, &pixels, [0.3, 0.5, 0.4]).unwrap();
        // A millimetre at 3 m is about a third of a pixel at 1000 px.
        assert!(missed[1] > 0.5 && missed[1] < 1.5 && missed[0] < 1e-12, "{missed:?}");
        assert!((sides[0] - 0.003).abs() < 1e-12 && sides[2].abs() < 1e-12, "{sides:?}");
    }
}
