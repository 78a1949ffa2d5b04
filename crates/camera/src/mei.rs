//! Mei's omnidirectional camera: OpenCV's `omnidir`, Kalibr's "omni-radtan".
//!
//! Section II of Mei & Rives 2007 with two radial coefficients. The point on the unit sphere is seen
//! from ξ behind its centre, `(X, Y) / (Z + ξ d)`, and then distorted as OpenCV's four-parameter lens
//! does. OpenCV's skew is not part of the model.

use std::f64::consts::PI;

use boresight_geometry::Scalar;

use crate::opencv::{distort, undistort};
use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::roots::smallest_positive_root;
use crate::sphere::finite;
use crate::{CameraModel, ParamGroup};

/// Mei's camera: parameters `fx fy cx cy xi k1 k2 p1 p2`, with xi above -1.
///
/// Near the axis the image grows by `fx / (1 + xi)`. With xi = 0 it is OpenCV's lens, with xi = 1
/// the stereographic one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mei;

impl CameraModel for Mei {
    const NAME: &'static str = "mei";

    fn param_count(&self) -> usize {
        9
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["xi", "k1", "k2", "p1", "p2"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        use ParamGroup::{Radial, Sphere, Tangential};
        [&CORE_GROUPS[..], &[Sphere, Radial, Radial, Tangential, Tangential]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        let xi = params[4];
        let length = pz.mul_add(pz, px.mul_add(px, py * py)).sqrt();
        let depth = xi.mul_add(length, pz);
        // Where the second is negative, the radius shrinks as the angle grows.
        if !depth.all_above(0.0) || !xi.mul_add(pz, length).all_above(0.0) {
            return None;
        }
        let inverse = pz.like(1.0) / depth;
        let [x, y] = distort::<T, 4>(&params[5..], px * inverse, py * inverse);
        Some([params[0].mul_add(x, params[2]), params[1].mul_add(y, params[3])])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        // A millionth of a millipixel: far above rounding, far below what anyone measures.
        let tolerance = 1e-9 / params[0].max(params[1]);
        let [x, y] = undistort::<4>(&params[5..], image_plane_point(params, pixel), tolerance)?;
        let (scale, depth) = on_sphere(params[4], x * x + y * y);
        finite([scale * x, scale * y, depth])
    }

    /// Returns where the radial distortion folds back. The sphere itself grows in all of the model's domain.
    fn monotonic_limit(&self, params: &[f64]) -> Option<f64> {
        let (xi, k1, k2) = (params[4], params[5], params[6]);
        // Beyond 1e3 there is nothing but the last fraction of a degree.
        let upper = if xi > 1.0 { 1.0 / (xi * xi - 1.0) } else { 1e6 };
        let r2 = smallest_positive_root(&[1.0, 3.0 * k1, 5.0 * k2], upper)?;
        let (scale, depth) = on_sphere(xi, r2);
        let angle = (scale * r2.sqrt()).atan2(depth);
        (angle < PI).then_some(angle)
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0; 5]].concat()
    }

    fn wide(&self, [fx, fy, cx, cy]: [f64; 4]) -> Vec<f64> {
        vec![2.0 * fx, 2.0 * fy, cx, cy, 1.0, 0.0, 0.0, 0.0, 0.0]
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![
            (Self, vec![900.0, 902.0, 795.0, 605.0, 1.2, -0.05, 0.01, 1e-3, -5e-4]),
            (Self, vec![700.0, 699.0, 810.0, 590.0, 0.8, -0.1, 0.02, -3e-4, 4e-4]),
            (Self, vec![1250.0, 1245.0, 790.0, 610.0, 0.0, -0.1, 0.03, 1e-3, -5e-4]),
            (Self, vec![1100.0, 1100.0, 799.5, 599.5, -0.2, 0.0, 0.0, 0.0, 0.0]),
        ]
    }
}

/// Returns the scale and the depth with which an image-plane point of squared radius `r2` lies on the
/// unit sphere; NaN where it lies beside it.
fn on_sphere(xi: f64, r2: f64) -> (f64, f64) {
    let scale = (xi + (1.0 + (1.0 - xi * xi) * r2).sqrt()) / (r2 + 1.0);
    (scale, scale - xi)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_ends_where_the_radius_stops_to_grow() {
        // cos θ = -1/ξ: 120 degrees.
        let params = [800.0, 800.0, 800.0, 600.0, 2.0, 0.0, 0.0, 0.0, 0.0];
        let at = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Mei.project(&params, [sin, 0.0, cos])
        };
        assert!(at(119.99).is_some() && at(120.01).is_none());
        let edge = at(119.9999).unwrap()[0];
        assert!(Mei.unproject(&params, [edge, 600.0]).is_some());
        assert_eq!(Mei.unproject(&params, [edge + 0.1, 600.0]), None);
    }

    #[test]
    fn distortion_folds_at_its_angle() {
        // 1 + 3 k1 r² = 0 at r = 0.8; with ξ = 1, r = tan(θ/2).
        let mut params = [800.0, 800.0, 800.0, 600.0, 1.0, -1.0 / (3.0 * 0.64), 0.0, 0.0, 0.0];
        assert!((Mei.monotonic_limit(&params).unwrap() - 2.0 * 0.8_f64.atan()).abs() < 1e-14);
        params[5] = 0.1;
        assert_eq!(Mei.monotonic_limit(&params), None);
    }
}
