//! Kannala & Brandt's fisheye with four coefficients: `cv::fisheye`, Kalibr's "equidistant".
//!
//! Eq. 6 of Kannala & Brandt 2006, without its asymmetric terms and with the focal length taken
//! out as both tools do: `theta_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, and the image-plane
//! point lies at that radius in the direction of the point.

use std::f64::consts::PI;

use boresight_geometry::Scalar;

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, broadcast_core, image_plane_point};
use crate::roots::{evaluate, smallest_positive_root};
use crate::{CameraModel, ParamGroup};

/// The equidistant fisheye: parameters `fx fy cx cy k1 k2 k3 k4`.
///
/// It sees every direction but the exact backward axis, beyond 90 degrees too. Without distortion
/// it is the equidistant projection, not a pinhole: no finite coefficients make it rectilinear.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KannalaBrandt4;

impl CameraModel for KannalaBrandt4 {
    const IS_INLINED: bool = true;
    const NAME: &'static str = "kannala-brandt4";

    fn param_count(&self) -> usize {
        8
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["k1", "k2", "k3", "k4"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        [CORE_GROUPS, [ParamGroup::Radial; 4]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        let r2 = px.mul_add(px, py * py);
        let AngleByRadius { value: angle_by_radius, .. } = angle_by_radius(r2, pz)?;
        let theta2 = angle_by_radius * angle_by_radius * r2;
        let [k1, k2, k3, k4] = [params[4], params[5], params[6], params[7]];
        let growth =
            k4.mul_add(theta2, k3).mul_add(theta2, k2).mul_add(theta2, k1).mul_add(theta2, theta2.like(1.0));
        let scale = angle_by_radius * growth;
        Some([params[0].mul_add(px * scale, params[2]), params[1].mul_add(py * scale, params[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        [px, py, pz]: [T; 3],
        d_point: &mut [[T; 3]; 2],
        d_lens: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        let r2 = px.mul_add(px, py * py);
        let AngleByRadius { value: h, by_r2: h_by_r2, by_z: h_by_z } = angle_by_radius(r2, pz)?;
        let theta2 = h * h * r2;
        let growth = r2
            .like(params[7])
            .mul_add(theta2, r2.like(params[6]))
            .mul_add(theta2, r2.like(params[5]))
            .mul_add(theta2, r2.like(params[4]));
        let growth = growth.mul_add(theta2, theta2.like(1.0));
        let growth_slope = r2
            .like(4.0 * params[7])
            .mul_add(theta2, r2.like(3.0 * params[6]))
            .mul_add(theta2, r2.like(2.0 * params[5]))
            .mul_add(theta2, r2.like(params[4]));

        // The image-plane point is scale * (px, py), with scale = h growth(θ²) and θ² = h² r².
        let scale = h * growth;
        let scale_by_h = (theta2 + theta2).mul_add(growth_slope, growth);
        let scale_by_r2 = scale_by_h.mul_add(h_by_r2, h * h * h * growth_slope);
        let scale_by_z = scale_by_h * h_by_z;
        let [fx, fy, cx, cy] = broadcast_core(r2, params);
        let (u, v) = (fx * px, fy * py);
        let (by_px, by_py) = (scale_by_r2 * (px + px), scale_by_r2 * (py + py));
        *d_point = [
            [u.mul_add(by_px, fx * scale), u * by_py, u * scale_by_z],
            [v * by_px, v.mul_add(by_py, fy * scale), v * scale_by_z],
        ];
        for (out, ray) in d_lens.into_iter().zip([u * h, v * h]) {
            let out = &mut out[..4];
            out[0] = ray * theta2;
            for i in 1..4 {
                out[i] = out[i - 1] * theta2;
            }
        }
        Some([u.mul_add(scale, cx), v.mul_add(scale, cy)])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [x, y] = image_plane_point(params, pixel);
        let radius = x.hypot(y);
        if radius == 0.0 {
            return Some([0.0, 0.0, 1.0]);
        }
        let theta = angle_of_radius(params, radius)?;
        let (sin, cos) = theta.sin_cos();
        Some([x * (sin / radius), y * (sin / radius), cos])
    }

    fn monotonic_limit(&self, params: &[f64]) -> Option<f64> {
        // The derivative of theta_d, as a polynomial in θ².
        let slope = [1.0, 3.0 * params[4], 5.0 * params[5], 7.0 * params[6], 9.0 * params[7]];
        smallest_positive_root(&slope, PI * PI).map(f64::sqrt)
    }

    /// Returns the equidistant projection with the same core: all coefficients zero.
    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [core, [0.0; 4]].concat()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![
            // 180 degrees across the height of the image.
            (Self, vec![380.0, 381.0, 795.0, 605.0, -0.01, 0.005, -0.002, 3e-4]),
            // A 220 degree lens whose radius grows up to there.
            (Self, vec![310.0, 309.0, 802.0, 598.0, 0.05, -0.01, 0.002, -2e-4]),
            // A narrow lens with strong distortion, which folds back at 66 degrees.
            (Self, vec![900.0, 905.0, 780.0, 620.0, -0.3, 0.1, -0.05, 0.01]),
            (Self, vec![480.0, 480.0, 799.5, 599.5, 0.0, 0.0, 0.0, 0.0]),
        ]
    }
}

/// The angle off axis over the radius, θ/r, with its derivatives by r² and by z.
struct AngleByRadius<T> {
    value: T,
    by_r2: T,
    by_z: T,
}

/// Returns θ/r, or `None` on the backward axis.
#[inline(always)]
fn angle_by_radius<T: Scalar>(r2: T, pz: T) -> Option<AngleByRadius<T>> {
    // In front of the camera anything goes; elsewhere a radius is needed to tell the direction.
    if !pz.select_below(f64::MIN_POSITIVE, r2, pz).all_above(0.0) {
        return None;
    }
    // Near the axis r has no derivative; there, θ/r = atan(t)/(t z) as a series in t² = r²/z². What
    // is left out is t¹⁰/11, below 1e-21. The branch not taken may be NaN; it is never selected.
    const NEAR: f64 = 1e-4;
    let c = |value: f64| r2.like(value);
    let inverse_z = pz.like(1.0) / pz;
    let inverse_z2 = inverse_z * inverse_z;
    let t2 = r2 * inverse_z2;
    let series = c(1.0 / 9.0).mul_add(t2, c(-1.0 / 7.0)).mul_add(t2, c(1.0 / 5.0)).mul_add(t2, c(-1.0 / 3.0));
    let slope = c(4.0 / 9.0).mul_add(t2, c(-3.0 / 7.0)).mul_add(t2, c(2.0 / 5.0)).mul_add(t2, c(-1.0 / 3.0));

    let r = r2.sqrt();
    let far = r.atan2(pz) / r;
    let by_z = -(pz.like(1.0) / pz.mul_add(pz, r2));
    let select = |near: T, far: T| pz.select_below(f64::MIN_POSITIVE, far, t2.select_below(NEAR, near, far));
    Some(AngleByRadius {
        value: select(series.mul_add(t2, c(1.0)) * inverse_z, far),
        by_r2: select(slope * inverse_z2 * inverse_z, -by_z.mul_add(pz, far) / (r2 + r2)),
        by_z,
    })
}

/// Returns the angle off axis, in radians, whose image-plane radius is `radius`, if the lens
/// reaches that far before it folds back.
fn angle_of_radius(params: &[f64], radius: f64) -> Option<f64> {
    let [k1, k2, k3, k4] = [params[4], params[5], params[6], params[7]];
    let image = |theta: f64| theta * evaluate(&[1.0, k1, k2, k3, k4], theta * theta);
    let slope = |theta: f64| evaluate(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], theta * theta);
    let mut low = 0.0;
    let mut high = KannalaBrandt4.monotonic_limit(params).unwrap_or(PI);
    // The backward axis itself is no direction, hence strictly less.
    if radius.is_nan() || radius >= image(high) {
        return None;
    }
    // Newton, and bisection wherever Newton leaves the bracket.
    let mut theta = radius.min(0.5 * high);
    for _ in 0..200 {
        let excess = image(theta) - radius;
        if excess == 0.0 {
            break;
        }
        if excess < 0.0 {
            low = theta
        } else {
            high = theta
        }
        let newton = theta - excess / slope(theta);
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - theta).abs() <= f64::EPSILON * theta {
            break;
        }
        theta = next;
    }
    Some(theta)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use boresight_geometry::Dual;

    use super::*;

    const EQUIDISTANT: [f64; 8] = [400.0, 400.0, 800.0, 600.0, 0.0, 0.0, 0.0, 0.0];

    #[test]
    fn radius_is_the_angle() {
        for (point, radius) in [
            ([1.0, 0.0, 1.0], 0.5 * FRAC_PI_2),
            ([1.0, 0.0, 0.0], FRAC_PI_2),
            ([1.0, 0.0, -1.0], 1.5 * FRAC_PI_2),
            ([1e-9, 0.0, -1.0], PI - 1e-9),
            ([1e-9, 0.0, 1.0], 1e-9),
        ] {
            let [u, v] = KannalaBrandt4.project(&EQUIDISTANT, point).unwrap();
            assert!((u - 800.0 - 400.0 * radius).abs() < 1e-12 && v == 600.0, "{point:?}");
        }
    }

    #[test]
    fn the_axis_is_smooth() {
        let params = EQUIDISTANT.map(Dual::<f64, 3>::fixed);
        let point = [Dual::variable(0.0, 0), Dual::variable(0.0, 1), Dual::variable(2.0, 2)];
        let [u, v] = KannalaBrandt4.project(&params, point).unwrap();
        assert_eq!((u.value, u.derivative), (800.0, [200.0, 0.0, 0.0]));
        assert_eq!((v.value, v.derivative), (600.0, [0.0, 200.0, 0.0]));
    }

    #[test]
    fn series_and_formula_meet() {
        // The two sides of the change at r/z = 0.01, whose values differ by the slope alone.
        let scale = |r: f64| KannalaBrandt4.project(&EQUIDISTANT, [r, 0.0, 1.0]).unwrap()[0] - 800.0;
        let (below, above) = (scale(0.01 - 1e-12), scale(0.01 + 1e-12));
        assert!((above - below - 400.0 * 2e-12 / 1.0001).abs() < 3e-13);
    }

    #[test]
    fn folds_end_the_range() {
        // 1 + 3 k1 θ² = 0 at θ = 1.
        let mut params = EQUIDISTANT;
        params[4] = -1.0 / 3.0;
        assert!((KannalaBrandt4.monotonic_limit(&params).unwrap() - 1.0).abs() < 1e-15);
        let at = |radius: f64| KannalaBrandt4.unproject(&params, [800.0 + 400.0 * radius, 600.0]);
        assert!(at(0.666).is_some());
        assert_eq!(at(0.667), None);
        // Without distortion the image ends at the backward axis.
        assert_eq!(KannalaBrandt4.monotonic_limit(&EQUIDISTANT), None);
        assert!(KannalaBrandt4.unproject(&EQUIDISTANT, [800.0 + 400.0 * 3.1, 600.0]).is_some());
        assert_eq!(KannalaBrandt4.unproject(&EQUIDISTANT, [800.0 + 400.0 * 3.2, 600.0]), None);
    }
}
