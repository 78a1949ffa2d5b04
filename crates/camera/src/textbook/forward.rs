//! Forward projection: the matrices P, M and H, Eqs 8.9 to 8.14, and what a lens adds.

use boresight_geometry::nalgebra::{Matrix3x4, Matrix4};
use boresight_geometry::{Point3, Pose};

use crate::Camera;

/// Where a point is seen, with the scale factor of Eq. 8.13.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// The column index in pixels.
    pub u: f64,
    /// The row index in pixels.
    pub v: f64,
    /// The scale factor: the depth z of the point in the camera frame, in metres, if the bottom
    /// row of the rotation part of `H` has unit length.
    pub s: f64,
}

/// Returns the matrix `P` from the camera frame to the index frame, for the core
/// `[fx, fy, u0, v0]` in pixels: Eq. 8.10.
pub fn p_matrix([fx, fy, u0, v0]: [f64; 4]) -> Matrix3x4<f64> {
    Matrix3x4::new(fx, 0.0, u0, 0.0, 0.0, fy, v0, 0.0, 0.0, 0.0, 1.0, 0.0)
}

/// Returns the homogeneous matrix `M` from the reference frame to the camera frame: Eq. 8.12.
pub fn m_matrix(cam_from_ref: &Pose) -> Matrix4<f64> {
    let mut m = Matrix4::identity();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&cam_from_ref.rotation_matrix());
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(&cam_from_ref.translation);
    m
}

/// Returns the calibration matrix `H = P M`, from the reference frame to the index frame: Eq. 8.14.
pub fn h_matrix(core: [f64; 4], cam_from_ref: &Pose) -> Matrix3x4<f64> {
    p_matrix(core) * m_matrix(cam_from_ref)
}

/// Returns the forward projection by a calibration matrix, without distortion: Eq. 8.13.
///
/// `None` where the scale factor is not positive: behind the camera, for an `H` made here.
pub fn project_by_h(h: &Matrix3x4<f64>, point_in_ref: &Point3<f64>) -> Option<Projection> {
    let [x, y, s]: [f64; 3] = (h * point_in_ref.to_homogeneous()).into();
    (s > 0.0).then(|| Projection { u: x / s, v: y / s, s })
}

/// Returns the forward projection through the whole lens, distortion included.
///
/// `None` where the lens does not see the point. The scale factor is the depth in the camera frame
/// in metres, which a fisheye may see at or below zero.
pub fn project_by_lens(
    camera: &Camera,
    cam_from_ref: &Pose,
    point_in_ref: &Point3<f64>,
) -> Option<Projection> {
    let point_in_cam = *cam_from_ref * *point_in_ref;
    let [u, v] = camera.project(&point_in_cam.coords)?;
    Some(Projection { u, v, s: point_in_cam.z })
}

#[cfg(test)]
mod tests {
    use boresight_geometry::Vector3;

    use super::*;

    #[test]
    fn h_projects_as_an_undistorted_lens() {
        let core = [1200.0, 1190.0, 800.5, 610.0];
        let cam_from_ref = Pose::from_rodrigues(Vector3::new(0.2, -0.4, 0.1), Vector3::new(0.1, -0.2, 1.5));
        let h = h_matrix(core, &cam_from_ref);
        for name in ["pinhole", "opencv8"] {
            let model: crate::Model = name.parse().unwrap();
            let camera = Camera::new(model, model.undistorted(core), [1600, 1200]).unwrap();
            for point in [Point3::new(0.1, 0.2, 0.3), Point3::new(-0.4, 0.1, 0.9), Point3::origin()] {
                let by_h = project_by_h(&h, &point).unwrap();
                let by_lens = project_by_lens(&camera, &cam_from_ref, &point).unwrap();
                // Pixels near 1000 have 1.1e-13 as their last place.
                assert!((by_h.u - by_lens.u).abs() < 1e-12 && (by_h.v - by_lens.v).abs() < 1e-12);
                assert!((by_h.s - by_lens.s).abs() < 1e-15);
            }
            let behind = cam_from_ref.inverse() * Point3::new(0.1, 0.0, -1.0);
            assert_eq!(project_by_h(&h, &behind), None);
            assert_eq!(project_by_lens(&camera, &cam_from_ref, &behind), None);
        }
    }

    #[test]
    fn distortion_moves_the_pixel_not_the_depth() {
        let params = vec![1200.0, 1190.0, 800.5, 610.0, -0.2, 0.05, 1e-3, 0.0, 0.0];
        let camera = Camera::new("opencv5".parse().unwrap(), params, [1600, 1200]).unwrap();
        let point = Point3::new(0.6, 0.0, 2.0);
        let distorted = project_by_lens(&camera, &Pose::identity(), &point).unwrap();
        // x = 0.3, r² = 0.09: 0.3 (1 - 0.018 + 0.000405) = 0.2947215.
        assert!((distorted.u - (800.5 + 1200.0 * 0.294_721_5)).abs() < 1e-9);
        assert_eq!(distorted.s, 2.0);
    }
}
