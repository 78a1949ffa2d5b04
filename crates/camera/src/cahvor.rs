//! CAHVOR and CAHVORE in mrcal's parametrisation.
//!
//! Yakimovsky & Cunningham 1978 and Gennery 2006, as mrcal's documentation ("Lens models") has them: a
//! pinhole core, an optical axis `o = (sin α cos β, sin β, cos α cos β)`, and radial terms about it. With
//! `ζ = p·o`, `l = |p - ζ o|` the pinhole sees, for CAHVOR with `τ = l² / ζ²`,
//! `p' = ζ o + (1 + r0 + r1 τ + r2 τ²) (p - ζ o)`.
//!
//! For CAHVORE with linearity L, θ solves `ζ sin θ - l cos θ = (θ - sin θ) (e0 + e1 θ² + e2 θ⁴)`, χ is
//! `tan(L θ)/L` for L > 0, θ for L = 0, `sin(L θ)/L` for L < 0, and
//! `p' = (l/χ) o + (1 + r0 + r1 χ² + r2 χ⁴) (p - ζ o)`.

use std::f64::consts::{FRAC_PI_2, PI};

use boresight_geometry::{Scalar, Vector3};

use crate::model::linearize_lane_by_lane;
use crate::pinhole::{CORE_GROUPS, CORE_NAMES, image_plane_point};
use crate::roots::{evaluate, smallest_positive_root};
use crate::{CameraModel, ParamGroup};

/// CAHVOR: parameters `fx fy cx cy alpha beta r0 r1 r2`; sees what is in front of it and of its axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cahvor;

/// CAHVORE with its linearity: parameters `fx fy cx cy alpha beta r0 r1 r2 e0 e1 e2`.
///
/// The entrance pupil moves with the angle: unless all of `e0 e1 e2`, in metres, are zero there is no
/// one centre of projection, and a pixel sees no ray that
/// [`unproject`](CameraModel::unproject) could return.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cahvore {
    linearity: f64,
}

impl Cahvore {
    /// Returns the lens of this linearity, or `None` if it is not a number from -10 to 10: 1 is
    /// perspective, 0 equidistant.
    pub fn new(linearity: f64) -> Option<Self> {
        (linearity.abs() <= 10.0).then_some(Self { linearity: linearity + 0.0 })
    }

    /// Returns the linearity.
    pub fn linearity(&self) -> f64 {
        self.linearity
    }

    /// Returns the largest χ, and θ up to which there is one.
    fn reach(&self) -> (f64, f64) {
        let theta = if self.linearity == 0.0 { PI } else { (FRAC_PI_2 / self.linearity.abs()).min(PI) };
        let chi = if self.linearity > 0.0 {
            let chi = (self.linearity * theta).tan() / self.linearity;
            if chi > 0.0 { chi.min(1e3) } else { 1e3 }
        } else if self.linearity < 0.0 {
            (self.linearity * theta).sin() / self.linearity
        } else {
            PI
        };
        (chi, theta)
    }

    /// Returns θ of χ.
    fn theta(&self, chi: f64) -> f64 {
        if self.linearity > 0.0 {
            (self.linearity * chi).atan() / self.linearity
        } else if self.linearity < 0.0 {
            (self.linearity * chi).asin() / self.linearity
        } else {
            chi
        }
    }
}

/// A point along the optical axis and off it.
struct Split<T> {
    axis: [T; 3],
    along: T,
    off: [T; 3],
    off2: T,
}

impl<T: Scalar> Split<T> {
    #[inline(always)]
    fn new(params: &[T], [px, py, pz]: [T; 3]) -> Self {
        let (alpha, beta) = (params[4], params[5]);
        let level = beta.cos();
        let axis = [alpha.sin() * level, beta.sin(), alpha.cos() * level];
        let along = px.mul_add(axis[0], py.mul_add(axis[1], pz * axis[2]));
        let off = [px - along * axis[0], py - along * axis[1], pz - along * axis[2]];
        let off2 = off[0].mul_add(off[0], off[1].mul_add(off[1], off[2] * off[2]));
        Self { axis, along, off, off2 }
    }

    /// Returns the pixel of `along` on the axis and `1 + growth` times what is off it.
    #[inline(always)]
    fn pixel(&self, params: &[T], along: T, growth: T) -> Option<[T; 2]> {
        let factor = growth + along.like(1.0);
        let depth = along.mul_add(self.axis[2], factor * self.off[2]);
        if !depth.all_above(0.0) {
            return None;
        }
        let inverse = depth.like(1.0) / depth;
        let x = along.mul_add(self.axis[0], factor * self.off[0]) * inverse;
        let y = along.mul_add(self.axis[1], factor * self.off[1]) * inverse;
        Some([params[0].mul_add(x, params[2]), params[1].mul_add(y, params[3])])
    }
}

/// Returns the ray that a pixel sees, where `theta` tells the angle off axis from its tangent as the
/// pinhole sees it.
fn ray(params: &[f64], pixel: [f64; 2], theta: impl Fn(f64) -> Option<f64>) -> Option<[f64; 3]> {
    let [x, y] = image_plane_point(params, pixel);
    let split = Split::new(params, [x, y, 1.0]);
    if split.along.is_nan() || split.along <= 0.0 || !split.off2.is_finite() {
        return None;
    }
    let axis = Vector3::from(split.axis);
    let off = split.off2.sqrt();
    if off == 0.0 {
        return Some(axis.into());
    }
    let theta = theta(off / split.along)?;
    Some((axis * theta.cos() + Vector3::from(split.off) * (theta.sin() / off)).into())
}

/// Returns where `x (1 + r0 + r1 x² + r2 x⁴)` is `value`, below `upper` and below any fold.
fn undo_radial(params: &[f64], value: f64, upper: f64) -> Option<f64> {
    let [r0, r1, r2] = [params[6], params[7], params[8]];
    let factor = [1.0 + r0, r1, r2];
    let slope = [1.0 + r0, 3.0 * r1, 5.0 * r2];
    let image = |x: f64| x * evaluate(&factor, x * x);
    let mut low = 0.0;
    let mut high = smallest_positive_root(&slope, upper * upper).map_or(upper, f64::sqrt);
    if slope[0] <= 0.0 || value.is_nan() || value > image(high) {
        return None;
    }
    // Newton, and bisection wherever Newton leaves the bracket.
    let mut x = (value / slope[0]).min(0.5 * high);
    for _ in 0..200 {
        let excess = image(x) - value;
        if excess == 0.0 {
            break;
        }
        if excess < 0.0 {
            low = x
        } else {
            high = x
        }
        let newton = x - excess / evaluate(&slope, x * x);
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() <= f64::EPSILON * x {
            break;
        }
        x = next;
    }
    Some(x)
}

/// The tangent of the largest angle off axis that CAHVOR is inverted to.
const MAX_TANGENT: f64 = 1e3;

impl CameraModel for Cahvor {
    const NAME: &'static str = "cahvor";

    fn param_count(&self) -> usize {
        9
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["alpha", "beta", "r0", "r1", "r2"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        [&CORE_GROUPS[..], &[ParamGroup::Tilt; 2], &[ParamGroup::Radial; 3]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], point_in_cam: [T; 3]) -> Option<[T; 2]> {
        let split = Split::new(params, point_in_cam);
        if !split.along.all_above(0.0) {
            return None;
        }
        let tau = split.off2 / (split.along * split.along);
        let growth = params[8].mul_add(tau, params[7]).mul_add(tau, params[6]);
        split.pixel(params, split.along, growth)
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        ray(params, pixel, |tangent| undo_radial(params, tangent, MAX_TANGENT).map(f64::atan))
    }

    fn monotonic_limit(&self, params: &[f64]) -> Option<f64> {
        let slope = [1.0 + params[6], 3.0 * params[7], 5.0 * params[8]];
        smallest_positive_root(&slope, MAX_TANGENT * MAX_TANGENT).map(|tau| tau.sqrt().atan())
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0; 5]].concat()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        vec![
            (Self, vec![1250.0, 1245.0, 790.0, 610.0, 0.02, -0.03, -0.01, 0.03, -0.002]),
            (Self, vec![1400.0, 1402.0, 810.0, 590.0, -0.01, 0.02, 0.02, -0.2, 0.05]),
            (Self, vec![1000.0, 1000.0, 799.5, 599.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ]
    }
}

impl CameraModel for Cahvore {
    const NAME: &'static str = "cahvore";

    const CONFIGURATION: Option<&'static str> = Some("a linearity from -10 to 10, such as linearity=0.37");

    fn configured(text: &str) -> Option<Self> {
        Self::new(text.strip_prefix("linearity=")?.parse().ok()?)
    }

    fn configuration(&self) -> Option<String> {
        Some(format!("linearity={}", self.linearity))
    }

    fn param_count(&self) -> usize {
        12
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &["alpha", "beta", "r0", "r1", "r2", "e0", "e1", "e2"]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        [&CORE_GROUPS[..], &[ParamGroup::Tilt; 2], &[ParamGroup::Radial; 3], &[ParamGroup::Pupil; 3]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], point_in_cam: [T; 3]) -> Option<[T; 2]> {
        let split = Split::new(params, point_in_cam);
        let Split { along, off2, .. } = split;
        // In front anything goes; elsewhere a distance off axis is needed to tell the direction.
        if !along.select_below(f64::MIN_POSITIVE, off2, along).all_above(0.0) {
            return None;
        }
        let pupil = [params[9], params[10], params[11]];
        let off = off2.sqrt();
        let mut theta = off.atan2(along);
        // Newton, whose last steps also carry the derivatives: one for the value, one for them.
        const MAX_STEPS: usize = 20;
        let mut is_last = false;
        for _ in 0..MAX_STEPS {
            let (sin, cos) = (theta.sin(), theta.cos());
            let theta2 = theta * theta;
            let shift = pupil[2].mul_add(theta2, pupil[1]).mul_add(theta2, pupil[0]);
            let shift_slope = theta * pupil[2].scale(4.0).mul_add(theta2, pupil[1].scale(2.0));
            let lag = theta - sin;
            let excess = along * sin - off * cos - lag * shift;
            let slope = along * cos + off * sin - (theta.like(1.0) - cos) * shift - lag * shift_slope;
            let step = excess / slope;
            theta = theta - step;
            if is_last {
                break;
            }
            is_last = (-(step * step)).all_above(-1e-24);
        }
        if !is_last || !(-theta).all_above(-self.reach().1) {
            return None;
        }
        let bent = theta.scale(self.linearity);
        let chi = if self.linearity > 0.0 {
            (bent.sin() / bent.cos()).scale(1.0 / self.linearity)
        } else if self.linearity < 0.0 {
            bent.sin().scale(1.0 / self.linearity)
        } else {
            theta
        };
        // Near the axis l has no derivative. There, with t = l/ζ, θ = t - t³ (1/3 - e0/(6 ζ)) and
        // χ = θ + curl θ³; what is left out is of order t⁴, below 1e-16.
        const NEAR: f64 = 1e-8;
        let l = self.linearity;
        let curl = if l > 0.0 { l * l / 3.0 } else { -l * l / 6.0 };
        let t2 = off2 / (along * along);
        let bend = along.like(curl - 1.0 / 3.0) + pupil[0] / along.scale(6.0);
        let one_more = t2.mul_add(bend, along.like(1.0));
        let select =
            |near: T, far: T| along.select_below(f64::MIN_POSITIVE, far, t2.select_below(NEAR, near, far));
        let chi2 = select(t2 * one_more * one_more, chi * chi);
        let depth = select(along / one_more, off / chi);
        let growth = params[8].mul_add(chi2, params[7]).mul_add(chi2, params[6]);
        split.pixel(params, depth, growth)
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

    /// Returns a point on the ray that `pixel` sees, or `None` also where the entrance pupil moves.
    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        if params[9..12] != [0.0; 3] {
            return None;
        }
        let (largest, _) = self.reach();
        ray(params, pixel, |tangent| undo_radial(params, tangent, largest).map(|chi| self.theta(chi)))
    }

    fn monotonic_limit(&self, params: &[f64]) -> Option<f64> {
        let (largest, _) = self.reach();
        let slope = [1.0 + params[6], 3.0 * params[7], 5.0 * params[8]];
        smallest_positive_root(&slope, largest * largest).map(|chi2| self.theta(chi2.sqrt()))
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        [&core[..], &[0.0; 8]].concat()
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        let lens = |linearity: f64, params: [f64; 9]| (Self { linearity }, [&params[..], &[0.0; 3]].concat());
        vec![
            // A tilted axis would make the backward axis of the camera an ordinary direction.
            lens(0.0, [600.0, 602.0, 795.0, 605.0, 0.0, 0.0, -0.01, 0.03, -0.002]),
            lens(0.37, [900.0, 899.0, 810.0, 590.0, 0.0, 0.0, 0.02, -0.05, 0.005]),
            lens(-0.5, [800.0, 800.0, 799.5, 599.5, 0.0, 0.0, 0.0, 0.02, 0.0]),
            lens(1.0, [1250.0, 1245.0, 790.0, 610.0, 0.02, -0.03, -0.01, 0.03, -0.002]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use boresight_geometry::Dual;

    use super::*;

    const LENS: [f64; 12] =
        [1250.0, 1245.0, 790.0, 610.0, 0.02, -0.03, -0.01, 0.03, -0.02, 5e-3, -3e-3, 1e-3];

    #[test]
    fn the_pupil_moves_and_its_derivatives_are_those_of_differences() {
        for linearity in [-0.5, 0.0, 0.37, 1.0] {
            let lens = Cahvore::new(linearity).unwrap();
            for point in [[0.3, -0.2, 1.0], [-0.07, 0.05, 0.13], [0.02, -0.03, 1.0], [2e-6, -3e-6, 1.0]] {
                for i in 4..12 {
                    let mut params = LENS.map(Dual::<f64, 1>::fixed);
                    params[i].derivative = [1.0];
                    let found = lens.project(&params, point.map(Dual::fixed)).unwrap();
                    let moved = |step: f64| {
                        let mut params = LENS;
                        params[i] += step;
                        lens.project(&params, point).unwrap()
                    };
                    let (plus, minus) = (moved(1e-5), moved(-1e-5));
                    for row in 0..2 {
                        let difference = (plus[row] - minus[row]) / 2e-5;
                        // Rounding of pixels near 1000 over the step, and the third derivative.
                        let error = (found[row].derivative[0] - difference).abs();
                        assert!(
                            error < 1e-6 * (1.0 + difference.abs()),
                            "{linearity} {point:?} {i}: {error:e}"
                        );
                    }
                }
            }
            assert_eq!(lens.unproject(&LENS, [800.0, 600.0]), None);
            let [near, far] = [0.2, 1e6].map(|d| lens.project(&LENS, [0.5 * d, 0.1 * d, d]).unwrap());
            assert!((near[0] - far[0]).abs() > 0.1);
        }
    }

    #[test]
    fn near_and_far_formulas_meet() {
        for linearity in [-0.5, 0.0, 0.37, 1.0] {
            let lens = Cahvore::new(linearity).unwrap();
            let mut params = LENS;
            (params[4], params[5]) = (0.0, 0.0);
            // The two sides of the change at l/ζ = 1e-4; the slope there is f (1 + r0).
            let at = |x: f64| lens.project(&params, [x, 0.0, 1.0]).unwrap()[0];
            let step = at(1e-4 + 1e-9) - at(1e-4 - 1e-9);
            assert!((step - 1250.0 * 0.99 * 2e-9).abs() < 1e-12, "{step:e}");
        }
    }
}
