//! mrcal's `LENSMODEL_LONLAT` and `LENSMODEL_LATLON`: longitude and latitude as pixels.
//!
//! Panoramas and rectified pairs have these projections; no lens does. `fx` and `fy` are in pixels per
//! radian. The formulas are those of mrcal's documentation ("Lens models"), with `asin(y / |p|)` written
//! as `atan2(y, hypot(x, z))`, which is as precise at the poles.

use std::f64::consts::{FRAC_PI_2, PI};

use boresight_geometry::Scalar;

use crate::model::linearize_lane_by_lane;
use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::{CameraModel, ParamGroup};

/// Longitude across, latitude down: `u = fx atan2(x, z) + cx`, `v = fy asin(y / |p|) + cy`.
///
/// It sees every direction but the poles on the y axis and the seam behind the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LonLat;

/// Latitude across, longitude down: `u = fx asin(x / |p|) + cx`, `v = fy atan2(y, z) + cy`.
///
/// It sees every direction but the poles on the x axis and the seam behind the camera. Epipolar lines
/// of a pair along x are rows of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LatLon;

/// Returns longitude and latitude of a point whose pole is the second axis; `None` at poles and seam.
#[inline(always)]
fn angles<T: Scalar>([along, pole, depth]: [T; 3]) -> Option<[T; 2]> {
    let off_pole = along.mul_add(along, depth * depth);
    // In front anything goes; behind, a point on the seam would have two pixels.
    let off_seam = depth.select_below(f64::MIN_POSITIVE, along * along, off_pole);
    if !off_seam.all_above(0.0) {
        return None;
    }
    Some([along.atan2(depth), pole.atan2(off_pole.sqrt())])
}

/// Returns the direction of longitude and latitude, or `None` beyond the poles or the seam.
fn direction([longitude, latitude]: [f64; 2]) -> Option<[f64; 3]> {
    if !(longitude.abs() < PI && latitude.abs() < FRAC_PI_2) {
        return None;
    }
    let ([sin, cos], [up, level]) = ([longitude.sin(), longitude.cos()], [latitude.sin(), latitude.cos()]);
    Some([level * sin, up, level * cos])
}

impl CameraModel for LonLat {
    const NAME: &'static str = "lonlat";

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
        let [longitude, latitude] = angles([px, py, pz])?;
        Some([params[0].mul_add(longitude, params[2]), params[1].mul_add(latitude, params[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        point_in_cam: [T; 3],
        d_point: &mut [[T; 3]; 2],
        d_lens: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        linearize_lane_by_lane(self, params, point_in_cam, d_point, d_lens)
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        direction(image_plane_point(params, pixel))
    }

    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        core.to_vec()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![(Self, vec![700.0, 702.0, 801.0, 597.0]), (Self, vec![500.0, 900.0, 770.0, 630.0])]
    }
}

impl CameraModel for LatLon {
    const NAME: &'static str = "latlon";

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
        let [longitude, latitude] = angles([py, px, pz])?;
        Some([params[0].mul_add(latitude, params[2]), params[1].mul_add(longitude, params[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        point_in_cam: [T; 3],
        d_point: &mut [[T; 3]; 2],
        d_lens: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        linearize_lane_by_lane(self, params, point_in_cam, d_point, d_lens)
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [latitude, longitude] = image_plane_point(params, pixel);
        let [y, x, z] = direction([longitude, latitude])?;
        Some([x, y, z])
    }

    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        core.to_vec()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![(Self, vec![700.0, 702.0, 801.0, 597.0]), (Self, vec![900.0, 500.0, 770.0, 630.0])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panoramas_go_all_the_way_round() {
        let params = [100.0, 200.0, 800.0, 600.0];
        let back = LonLat.project(&params, [1e-9, 0.0, -1.0]).unwrap();
        assert!((back[0] - 800.0 - 100.0 * PI).abs() < 1e-6 && back[1] == 600.0);
        assert_eq!(LonLat.project(&params, [0.0, 0.3, -1.0]), None);
        assert_eq!(LonLat.project(&params, [0.0, 1.0, 0.0]), None);
        let up = LatLon.project(&params, [0.0, 1.0, 0.0]).unwrap();
        assert!(up[0] == 800.0 && (up[1] - 600.0 - 200.0 * FRAC_PI_2).abs() < 1e-12);
        assert_eq!(LonLat.unproject(&params, [800.0, 600.0 + 200.0 * 1.58]), None);
        assert_eq!(LonLat.unproject(&params, [800.0 + 100.0 * 3.15, 600.0]), None);
    }
}
