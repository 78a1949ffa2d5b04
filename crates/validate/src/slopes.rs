//! A camera's pixel and how it moves with the point and with each parameter of the lens.

use boresight_camera::{Camera, CameraModel, ModelVisitor};
use boresight_geometry::nalgebra::Matrix2x3;
use boresight_geometry::{Matrix3, Vector3, skew};

/// The derivatives of a pixel; room that is used again from point to point.
#[derive(Clone, Debug, Default)]
pub(crate) struct Slopes {
    /// Where the camera sees the point.
    pub(crate) pixel: [f64; 2],
    /// By the point in the camera frame: a row for u, one for v.
    pub(crate) by_point: Matrix2x3<f64>,
    /// By each parameter of the lens, fx fy cx cy first: for u, then for v.
    pub(crate) by_param: [Vec<f64>; 2],
}

impl Slopes {
    /// Differentiates at a point, or returns `None` outside the lens's domain.
    pub(crate) fn fill(&mut self, camera: &Camera, point_in_cam: &Vector3<f64>) -> Option<()> {
        camera.model.visit(Fill { slopes: self, camera, point: (*point_in_cam).into() })
    }

    /// Returns how the pixel moves with a left perturbation of the camera's pose by which the point is
    /// seen: rotation, then translation in metres.
    pub(crate) fn by_motion(&self, point_in_cam: &Vector3<f64>) -> [Matrix2x3<f64>; 2] {
        [-self.by_point * skew(point_in_cam), self.by_point]
    }

    /// Returns the shortest displacement of the point in metres, for each of u and v, that moves the
    /// pixel by one: 3x2, square to the ray. `None` where the lens folds.
    pub(crate) fn point_by_pixel(&self) -> Option<boresight_geometry::nalgebra::Matrix3x2<f64>> {
        let gram = self.by_point * self.by_point.transpose();
        Some(self.by_point.transpose() * gram.try_inverse()?)
    }
}

/// Returns the rotation with the axis through zero that a point feels: `-[p]x`.
pub(crate) fn by_turn(point: &Vector3<f64>) -> Matrix3<f64> {
    -skew(point)
}

struct Fill<'a> {
    slopes: &'a mut Slopes,
    camera: &'a Camera,
    point: [f64; 3],
}

impl ModelVisitor for Fill<'_> {
    type Output = Option<()>;

    fn visit<M: CameraModel>(self, model: M) -> Option<()> {
        let params = &self.camera.params;
        let [by_u, by_v] = &mut self.slopes.by_param;
        by_u.clear();
        by_v.clear();
        by_u.resize(params.len(), 0.0);
        by_v.resize(params.len(), 0.0);
        let mut d_point = [[0.0; 3]; 2];
        let pixel = model.linearize(params, self.point, &mut d_point, [&mut by_u[4..], &mut by_v[4..]])?;
        // The pixel is (fx x + cx, fy y + cy).
        by_u[0] = (pixel[0] - params[2]) / params[0];
        by_v[1] = (pixel[1] - params[3]) / params[1];
        by_u[2] = 1.0;
        by_v[3] = 1.0;
        self.slopes.pixel = pixel;
        self.slopes.by_point = Matrix2x3::from_fn(|row, axis| d_point[row][axis]);
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_what_differences_find() {
        let params = vec![500.0, 510.0, 320.0, 240.0, -0.2, 0.05, 1e-3, -2e-3, 0.01];
        let camera = Camera::new("opencv5".parse().unwrap(), params, [640, 480]).unwrap();
        let point = Vector3::new(0.3, -0.2, 1.1);
        let mut slopes = Slopes::default();
        slopes.fill(&camera, &point).unwrap();
        let step = 1e-6;
        let close = |found: f64, expected: f64| (found - expected).abs() < 1e-6 * (1.0 + expected.abs());
        for i in 0..9 {
            let moved = |by: f64| {
                let mut moved = camera.clone();
                moved.params[i] += by;
                moved.project(&point).unwrap()
            };
            for axis in 0..2 {
                let difference = (moved(step)[axis] - moved(-step)[axis]) / (2.0 * step);
                assert!(close(slopes.by_param[axis][i], difference), "{i} {axis} {difference}");
            }
        }
        let by_pixel = slopes.point_by_pixel().unwrap();
        let identity = slopes.by_point * by_pixel;
        assert!((identity - boresight_geometry::nalgebra::Matrix2::identity()).norm() < 1e-12);
        assert!((point.transpose() * by_pixel).norm() < 1e-12 * point.norm());
    }
}
