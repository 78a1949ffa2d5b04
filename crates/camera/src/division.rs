//! The division model with one coefficient.
//!
//! Fitzgibbon 2001: an image-plane point at radius `r` sees the direction `(x, y, 1 + λ r²)`. Solved for
//! the image-plane point this is `2 (X, Y) / (Z + sqrt(Z² - 4 λ (X² + Y²)))`.

use boresight_geometry::Scalar;

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::sphere::finite;
use crate::{CameraModel, ParamGroup};

/// The division lens: parameters `fx fy cx cy lambda`.
///
/// With a negative lambda, barrel distortion, it sees every direction but the exact backward axis; with
/// -1/4 it is stereographic. A positive one is pincushion distortion and sees as far as
/// `tan θ = 1 / (2 sqrt(λ))`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Division;

impl CameraModel for Division {
    const NAME: &'static str = "division";

    fn param_count(&self) -> usize {
        5
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["lambda"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        [&CORE_GROUPS[..], &[ParamGroup::Radial]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        let barrel = params[4].scale(-4.0) * px.mul_add(px, py * py);
        let root = pz.mul_add(pz, barrel).sqrt();
        // Behind the camera the sum would cancel. The branch not taken may be NaN; it is never selected.
        let depth = pz.select_below(0.0, barrel / (root - pz), root + pz);
        if !root.all_above(0.0) || !depth.all_above(0.0) {
            return None;
        }
        let scale = pz.like(2.0) / depth;
        Some([params[0].mul_add(px * scale, params[2]), params[1].mul_add(py * scale, params[3])])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [x, y] = image_plane_point(params, pixel);
        let bend = params[4] * (x * x + y * y);
        // Of two radii that see the same direction the smaller is the lens's.
        if bend >= 1.0 {
            return None;
        }
        finite([x, y, 1.0 + bend])
    }

    /// Returns `None`: the image radius grows in all of the model's domain.
    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0]].concat()
    }

    fn wide(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[-0.25]].concat()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![
            (Self, vec![500.0, 502.0, 795.0, 605.0, -0.3]),
            (Self, vec![400.0, 399.0, 810.0, 590.0, -0.2]),
            (Self, vec![1200.0, 1205.0, 790.0, 610.0, 0.15]),
            (Self, vec![1000.0, 1000.0, 799.5, 599.5, 0.0]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pincushion_ends() {
        // tan θ = 1 / (2 sqrt(λ)) = 1, at radius 1 / sqrt(λ) = 2.
        let params = [100.0, 100.0, 800.0, 600.0, 0.25];
        assert!(Division.project(&params, [0.9999, 0.0, 1.0]).is_some());
        assert_eq!(Division.project(&params, [1.0001, 0.0, 1.0]), None);
        assert!(Division.unproject(&params, [999.0, 600.0]).is_some());
        assert_eq!(Division.unproject(&params, [1001.0, 600.0]), None);
    }
}
