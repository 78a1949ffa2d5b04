//! The stereographic projection, of which the image radius is `2 f tan(θ/2)`.
//!
//! mrcal's `LENSMODEL_STEREOGRAPHIC`. With `n = |p|` the image-plane point is `2 (px, py) / (n + pz)`.

use boresight_geometry::Scalar;

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, broadcast_core, image_plane_point};
use crate::{CameraModel, ParamGroup};

/// The stereographic lens: parameters `fx fy cx cy`; sees every direction but the exact backward axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stereographic;

impl CameraModel for Stereographic {
    const NAME: &'static str = "stereographic";

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
    fn project<T: Scalar>(&self, params: &[T], point_in_cam: [T; 3]) -> Option<[T; 2]> {
        let [x, y] = to_plane(point_in_cam)?;
        Some([params[0].mul_add(x, params[2]), params[1].mul_add(y, params[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        point_in_cam: [T; 3],
        d_point: &mut [[T; 3]; 2],
        _: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        let ([x, y], by_point) = linearize_to_plane(point_in_cam)?;
        let [fx, fy, cx, cy] = broadcast_core(x, params);
        for axis in 0..3 {
            d_point[0][axis] = fx * by_point[0][axis];
            d_point[1][axis] = fy * by_point[1][axis];
        }
        Some([fx.mul_add(x, cx), fy.mul_add(y, cy)])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let plane = image_plane_point(params, pixel);
        plane.iter().all(|x| x.is_finite()).then(|| from_plane(plane))
    }

    fn monotonic_limit(&self, _: &[f64]) -> Option<f64> {
        None
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        core.to_vec()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![(Self, vec![1200.0, 1210.0, 801.0, 597.0]), (Self, vec![250.0, 249.0, 770.0, 630.0])]
    }
}

/// Returns `n + pz`, which is `n (1 + cos θ)`, and the length `n`; `None` on the backward axis.
#[inline(always)]
fn length_and_depth<T: Scalar>([px, py, pz]: [T; 3]) -> Option<[T; 2]> {
    let r2 = px.mul_add(px, py * py);
    let length = pz.mul_add(pz, r2).sqrt();
    // Behind the camera the sum would cancel. The branch not taken may be NaN; it is never selected.
    let depth = pz.select_below(0.0, r2 / (length - pz), length + pz);
    depth.all_above(0.0).then_some([length, depth])
}

/// Returns the stereographic image-plane point, or `None` on the backward axis.
#[inline(always)]
pub(crate) fn to_plane<T: Scalar>(point_in_cam: [T; 3]) -> Option<[T; 2]> {
    let [_, depth] = length_and_depth(point_in_cam)?;
    let scale = depth.like(2.0) / depth;
    Some([point_in_cam[0] * scale, point_in_cam[1] * scale])
}

/// Returns the stereographic image-plane point with its derivatives by the point.
#[inline(always)]
pub(crate) fn linearize_to_plane<T: Scalar>(point_in_cam: [T; 3]) -> Option<([T; 2], [[T; 3]; 2])> {
    let [px, py, _] = point_in_cam;
    let [length, depth] = length_and_depth(point_in_cam)?;
    let inverse = depth.like(1.0) / depth;
    let scale = inverse + inverse;
    let (x, y) = (px * scale, py * scale);
    // d(n + pz) = (px, py, n + pz) / n; so d(x) = scale (1, 0, 0) - x d(n + pz) / (n + pz).
    let inverse_length = depth.like(1.0) / length;
    let fall = -(inverse * inverse_length);
    let (along_x, along_y) = (px * fall, py * fall);
    let d_point = [
        [x.mul_add(along_x, scale), x * along_y, -(x * inverse_length)],
        [y * along_x, y.mul_add(along_y, scale), -(y * inverse_length)],
    ];
    Some(([x, y], d_point))
}

/// Returns a direction whose stereographic image-plane point is `plane`.
pub(crate) fn from_plane([x, y]: [f64; 2]) -> [f64; 3] {
    // With t = tan(θ/2), sin θ : cos θ = 2t : 1 - t².
    [x, y, 1.0 - 0.25 * (x * x + y * y)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_radius_is_twice_the_tangent_of_half_the_angle() {
        let params = [300.0, 300.0, 800.0, 600.0];
        for angle in [0.0, 1e-7, 0.5, 1.6, 3.0, 3.1] {
            let [u, v] = Stereographic.project(&params, [0.0, angle.sin(), angle.cos()]).unwrap();
            let radius = 600.0 * f64::tan(0.5 * angle);
            assert!(u == 800.0 && (v - 600.0 - radius).abs() < 1e-12 * (1.0 + radius) * (1.0 + radius));
        }
    }
}
