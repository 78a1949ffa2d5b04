//! The pinhole: no distortion at all.

use boresight_geometry::Scalar;

use crate::{CameraModel, ParamGroup};

/// Names of the core parameters, with which every model begins.
pub(crate) const CORE_NAMES: [&str; 4] = ["fx", "fy", "cx", "cy"];

/// What the core parameters are for.
pub(crate) const CORE_GROUPS: [ParamGroup; 4] =
    [ParamGroup::Focal, ParamGroup::Focal, ParamGroup::Centre, ParamGroup::Centre];

/// The rectilinear lens: parameters `fx fy cx cy`; sees all that is in front of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pinhole;

impl CameraModel for Pinhole {
    const IS_INLINED: bool = true;
    const NAME: &'static str = "pinhole";

    fn param_count(&self) -> usize {
        CORE_NAMES.len()
    }

    fn param_names(&self) -> Vec<&'static str> {
        CORE_NAMES.to_vec()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        CORE_GROUPS.to_vec()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        if !pz.all_above(0.0) {
            return None;
        }
        let inverse_z = pz.like(1.0) / pz;
        let (x, y) = (px * inverse_z, py * inverse_z);
        Some([params[0].mul_add(x, params[2]), params[1].mul_add(y, params[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        [px, py, pz]: [T; 3],
        d_point: &mut [[T; 3]; 2],
        _: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        if !pz.all_above(0.0) {
            return None;
        }
        let inverse_z = pz.like(1.0) / pz;
        let (x, y) = (px * inverse_z, py * inverse_z);
        let [fx, fy, cx, cy] = broadcast_core(pz, params);
        let (along_x, along_y) = (fx * inverse_z, fy * inverse_z);
        *d_point = [[along_x, pz.like(0.0), -(along_x * x)], [pz.like(0.0), along_y, -(along_y * y)]];
        Some([fx.mul_add(x, cx), fy.mul_add(y, cy)])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [x, y] = image_plane_point(params, pixel);
        (x.is_finite() && y.is_finite()).then_some([x, y, 1.0])
    }

    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        core.to_vec()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![(Self, vec![1200.0, 1210.0, 801.0, 597.0]), (Self, vec![420.0, 418.0, 770.0, 630.0])]
    }
}

/// Returns the image-plane point that the core maps to `pixel`.
pub(crate) fn image_plane_point(params: &[f64], pixel: [f64; 2]) -> [f64; 2] {
    [(pixel[0] - params[2]) / params[0], (pixel[1] - params[3]) / params[1]]
}

/// Returns `fx, fy, cx, cy` in as many lanes as `like` has.
#[inline(always)]
pub(crate) fn broadcast_core<T: Scalar>(like: T, params: &[f64]) -> [T; 4] {
    // No closure: it would not have the caller's SIMD instructions and so not be inlined.
    [like.like(params[0]), like.like(params[1]), like.like(params[2]), like.like(params[3])]
}
