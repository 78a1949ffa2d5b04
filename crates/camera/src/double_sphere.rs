//! The double sphere model.
//!
//! Eqs. 40 to 46 of Usenko, Demmel & Cremers 2018, "The double sphere camera model". With `d1 = |p|`,
//! `z = ξ d1 + Z` and `d2² = X² + Y² + z²` the image-plane point is `(X, Y) / (α d2 + (1 - α) z)`.

use boresight_geometry::Scalar;

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::sphere::{depth_of_radius, finite, mixed_depth};
use crate::{CameraModel, ParamGroup};

/// The double sphere camera: parameters `fx fy cx cy xi alpha`, with xi within (-1, 1).
///
/// Near the axis the image grows by `fx / (1 + xi)`. Its domain is where the image radius grows with
/// the angle off axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DoubleSphere;

impl CameraModel for DoubleSphere {
    const NAME: &'static str = "double-sphere";

    fn param_count(&self) -> usize {
        6
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["xi", "alpha"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        [&CORE_GROUPS[..], &[ParamGroup::Sphere; 2]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        let (xi, one) = (params[4], pz.like(1.0));
        if !(one - xi * xi).all_above(0.0) {
            return None;
        }
        let r2 = px.mul_add(px, py * py);
        let depth = xi.mul_add(pz.mul_add(pz, r2).sqrt(), pz);
        let length = depth.mul_add(depth, r2).sqrt();
        let scale = one / mixed_depth(params[5], length, depth)?;
        Some([params[0].mul_add(px * scale, params[2]), params[1].mul_add(py * scale, params[3])])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let (xi, [x, y]) = (params[4], image_plane_point(params, pixel));
        let r2 = x * x + y * y;
        let depth = depth_of_radius(params[5], r2)?;
        // Back to the first sphere, the unit sphere: |k (x, y, depth) - (0, 0, ξ)| = 1.
        let scale = (depth * xi + (depth * depth + (1.0 - xi * xi) * r2).sqrt()) / (depth * depth + r2);
        finite([scale * x, scale * y, scale * depth - xi])
    }

    /// Returns `None`: the image radius grows in all of the model's domain.
    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0; 2]].concat()
    }

    fn wide(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0, 0.5]].concat()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![
            (Self, vec![330.0, 331.0, 795.0, 605.0, -0.2, 0.59]),
            (Self, vec![420.0, 419.0, 810.0, 590.0, 0.1, 0.45]),
            (Self, vec![900.0, 905.0, 790.0, 610.0, -0.3, -0.1]),
            (Self, vec![1000.0, 1000.0, 799.5, 599.5, 0.0, 0.0]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spheres_stay_within_each_other() {
        for xi in [-1.0, 1.0, 1.2] {
            let params = [400.0, 400.0, 800.0, 600.0, xi, 0.5];
            assert_eq!(DoubleSphere.project(&params, [0.1, 0.0, 1.0]), None);
        }
    }

    #[test]
    fn the_image_ends_where_the_radius_stops_to_grow() {
        // z + ξ = -w1 d2 with w1 = (1 - α)/α, solved for z on the unit sphere. Eq. 45 of the paper ends
        // the image a little earlier.
        let (xi, w1) = (-0.2, 0.25);
        let rest: f64 = 1.0 - w1 * w1;
        let w2 = xi * rest + w1 * (1.0 - xi * xi * rest).sqrt();
        let params = [400.0, 400.0, 800.0, 600.0, xi, 0.8];
        let at = |angle: f64| DoubleSphere.project(&params, [angle.sin(), 0.0, angle.cos()]);
        let edge = (-w2).acos();
        assert!(at(edge - 1e-6).is_some() && at(edge + 1e-6).is_none());
        let [u, _] = at(edge - 1e-6).unwrap();
        assert!(DoubleSphere.unproject(&params, [u, 600.0]).is_some());
        assert_eq!(DoubleSphere.unproject(&params, [u + 0.1, 600.0]), None);
    }
}
