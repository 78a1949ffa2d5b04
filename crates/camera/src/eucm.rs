//! The enhanced unified camera model.
//!
//! Khomutenko, Garcia & Martinet 2016; eqs. 26 to 31 of Usenko, Demmel & Cremers 2018, "The double
//! sphere camera model". With `d² = β (X² + Y²) + Z²` the image-plane point is
//! `(X, Y) / (α d + (1 - α) Z)`. With β = 1 it is the unified model (UCM).

use boresight_geometry::Scalar;

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::sphere::{depth_of_radius, finite, mixed_depth};
use crate::{CameraModel, ParamGroup};

/// The enhanced unified camera: parameters `fx fy cx cy alpha beta`.
///
/// With alpha = 0 it is a pinhole, with alpha = 1/2 and beta = 1 stereographic. Its domain is where the
/// image radius grows with the angle off axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Eucm;

impl CameraModel for Eucm {
    const NAME: &'static str = "eucm";

    fn param_count(&self) -> usize {
        6
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["alpha", "beta"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        [&CORE_GROUPS[..], &[ParamGroup::Sphere; 2]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        let r2 = px.mul_add(px, py * py);
        let length = params[5].mul_add(r2, pz * pz).sqrt();
        let scale = pz.like(1.0) / mixed_depth(params[4], length, pz)?;
        Some([params[0].mul_add(px * scale, params[2]), params[1].mul_add(py * scale, params[3])])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [x, y] = image_plane_point(params, pixel);
        finite([x, y, depth_of_radius(params[4], params[5] * (x * x + y * y))?])
    }

    /// Returns `None`: the image radius grows in all of the model's domain.
    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0, 1.0]].concat()
    }

    fn wide(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.5, 1.0]].concat()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![
            (Self, vec![460.0, 459.0, 795.0, 605.0, 0.6, 1.1]),
            (Self, vec![350.0, 352.0, 810.0, 590.0, 0.47, 0.9]),
            (Self, vec![1200.0, 1205.0, 790.0, 610.0, -0.1, 1.0]),
            (Self, vec![1000.0, 1000.0, 799.5, 599.5, 0.0, 1.0]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_ends_where_the_radius_stops_to_grow() {
        // α z + (1 - α) d = 0: z = -1/2 on the unit sphere, 120 degrees.
        let params = [400.0, 400.0, 800.0, 600.0, 2.0 / 3.0, 1.0];
        let at = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Eucm.project(&params, [sin, 0.0, cos])
        };
        assert!(at(119.99).is_some() && at(120.01).is_none());
        let edge = at(119.9999).unwrap()[0];
        assert!(Eucm.unproject(&params, [edge, 600.0]).is_some());
        assert_eq!(Eucm.unproject(&params, [edge + 0.1, 600.0]), None);
        // A negative beta has no real length anywhere off axis.
        assert_eq!(Eucm.project(&[400.0, 400.0, 800.0, 600.0, 0.5, -4.0], [1.0, 0.0, 1.0]), None);
    }
}
