//! OpenCV's lens: radial (polynomial or rational), tangential, thin-prism and tilt terms.
//!
//! The formula is that of OpenCV's documentation of the `calib3d` module ("Detailed Description"),
//! in OpenCV's order of parameters: `k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]]`.
//! With `x = X/Z`, `y = Y/Z` and `r² = x² + y²`:
//!
//! ```text
//! radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
//! x' = x radial + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
//! y' = y radial + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴
//! ```
//!
//! and, with 14 terms, a homography for the tilted sensor on top (`opencv/tilt.rs`).

mod distort;
mod tilt;
mod unproject;

use boresight_geometry::Scalar;

use crate::pinhole::{CORE_GROUPS, CORE_NAMES, broadcast_core, image_plane_point};
use crate::{CameraModel, ParamGroup};

pub(crate) use self::distort::distort;
use self::distort::linearize_distortion;
pub(crate) use self::unproject::undistort;

/// Names of the distortion parameters.
const LENS_NAMES: [&str; 14] =
    ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"];

/// OpenCV's lens with `N` distortion parameters: 4, 5, 8, 12 or 14.
///
/// Its domain is all that is in front of the camera and, with 14 parameters, of the tilted sensor.
/// Nothing else bounds [`project`](CameraModel::project): where the radial map folds back is told
/// by [`monotonic_limit`](CameraModel::monotonic_limit), not enforced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpenCv<const N: usize>;

impl<const N: usize> CameraModel for OpenCv<N> {
    // Tilt is differentiated by dual numbers.
    const IS_INLINED: bool = N < 14;
    const NAME: &'static str = match N {
        4 => "opencv4",
        5 => "opencv5",
        8 => "opencv8",
        12 => "opencv12",
        14 => "opencv14",
        _ => panic!("OpenCV knows 4, 5, 8, 12 or 14 distortion parameters"),
    };

    fn param_count(&self) -> usize {
        4 + N
    }

    fn param_names(&self) -> Vec<&'static str> {
        [&CORE_NAMES[..], &LENS_NAMES[..N]].concat()
    }

    fn param_groups(&self) -> Vec<ParamGroup> {
        use ParamGroup::{Radial, Rational, Tangential, ThinPrism, Tilt};
        let lens = [
            [Radial, Radial, Tangential, Tangential].as_slice(),
            &[Radial, Rational, Rational, Rational],
            &[ThinPrism; 4],
            &[Tilt; 2],
        ]
        .concat();
        [&CORE_GROUPS[..], &lens[..N]].concat()
    }

    #[inline(always)]
    fn project<T: Scalar>(&self, params: &[T], [px, py, pz]: [T; 3]) -> Option<[T; 2]> {
        if !pz.all_above(0.0) {
            return None;
        }
        let inverse_z = pz.like(1.0) / pz;
        let (core, lens) = params.split_at(4);
        let mut plane = distort::<T, N>(lens, px * inverse_z, py * inverse_z);
        if N >= 14 {
            plane = tilt::tilt([lens[12], lens[13]], plane)?;
        }
        Some([core[0].mul_add(plane[0], core[2]), core[1].mul_add(plane[1], core[3])])
    }

    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        point_in_cam: [T; 3],
        d_point: &mut [[T; 3]; 2],
        d_lens: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        if N >= 14 {
            return crate::model::linearize_with_duals(self, params, point_in_cam, d_point, d_lens);
        }
        let [px, py, pz] = point_in_cam;
        if !pz.all_above(0.0) {
            return None;
        }
        let inverse_z = pz.like(1.0) / pz;
        let (x, y) = (px * inverse_z, py * inverse_z);
        let [fx, fy, cx, cy] = broadcast_core(pz, params);
        let distorted = linearize_distortion::<T, N>(&params[4..4 + N], x, y);

        let (along_x, along_y) = (fx * inverse_z, fy * inverse_z);
        let [[xx, xy], [yx, yy]] = distorted.d_plane;
        let (u_x, u_y) = (along_x * xx, along_x * xy);
        let (v_x, v_y) = (along_y * yx, along_y * yy);
        *d_point = [[u_x, u_y, -u_x.mul_add(x, u_y * y)], [v_x, v_y, -v_x.mul_add(x, v_y * y)]];
        distorted.by_lens::<N>([fx, fy], [x, y], d_lens);
        Some([fx.mul_add(distorted.plane[0], cx), fy.mul_add(distorted.plane[1], cy)])
    }

    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]> {
        let (core, lens) = params.split_at(4);
        let mut plane = image_plane_point(core, pixel);
        if N >= 14 {
            plane = tilt::untilt([lens[12], lens[13]], plane)?;
        }
        // A millionth of a millipixel: far above rounding, far below what anyone measures.
        let tolerance = 1e-9 / core[0].max(core[1]);
        let [x, y] = undistort::<N>(lens, plane, tolerance)?;
        Some([x, y, 1.0])
    }

    fn monotonic_limit(&self, params: &[f64]) -> Option<f64> {
        // The scan ends at 50, which is 88.9 degrees.
        unproject::radius_limit::<N>(&params[4..], 50.0).map(f64::atan)
    }

    fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        let mut params = core.to_vec();
        params.resize(4 + N, 0.0);
        params
    }

    fn examples() -> Vec<(Self, Vec<f64>)> {
        let core = [1250.0, 1245.0, 790.0, 610.0];
        let wide = [620.0, 622.0, 805.0, 590.0];
        // Full sets of 14, of which a model takes the first N: a common lens, strong barrel, strong
        // pincushion, a rational wide-angle lens (as calibrated by mrcal) and one with a heavy
        // denominator (as factory calibrations of depth cameras have).
        let full = [
            (core, [-0.1, 0.03, 1e-3, -5e-4, -0.01, 0.01, -2e-3, 1e-3, 1e-3, -5e-4, 8e-4, 3e-4, 0.02, -0.03]),
            (
                core,
                [-0.27, -0.047, 1.8e-3, -3e-4, 0.25, 0.05, 0.02, 0.01, -2e-3, 1e-3, 1e-3, -1e-3, 0.1, -0.08],
            ),
            (core, [0.2, 0.1, -2e-3, 2e-3, 0.05, 0.02, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            (wide, [-0.01, 0.05, -5e-4, 2e-4, 0.03, 0.35, 0.02, 0.01, 1e-4, -1e-4, 2e-4, 1e-4, -0.01, 0.005]),
            (wide, [0.9, 0.12, 2e-4, -1e-4, 0.004, 1.25, 0.35, 0.02, -5e-4, 1e-4, 3e-4, -1e-4, 0.005, 0.01]),
        ];
        full.iter().map(|(core, lens)| (Self, [core, &lens[..N]].concat())).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[track_caller]
    fn check_limit<const N: usize>(lens: [f64; N], expected_radius: Option<f64>) {
        let params = [&[1000.0, 1000.0, 800.0, 600.0][..], &lens].concat();
        match (OpenCv::<N>.monotonic_limit(&params), expected_radius) {
            (Some(found), Some(expected)) => {
                assert!((found.tan() - expected).abs() < 1e-12, "{}", found.tan())
            }
            (found, expected) => assert_eq!(found, expected),
        }
    }

    #[test]
    fn radial_maps_end_at_folds_and_poles() {
        check_limit([0.1, 0.0, 0.0, 0.0], None);
        // 1 + 3 k1 r² = 0.
        check_limit([-0.3, 0.0, 0.0, 0.0], Some((1.0f64 / 0.9).sqrt()));
        // 1 + 7 k3 r⁶ = 0.
        check_limit([0.0, 0.0, 0.0, 0.0, -1.0 / 7.0], Some(1.0));
        // r / (1 - r²/4) has a pole at 2; r / (1 + r²) turns at 1.
        check_limit([0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0], Some(2.0));
        check_limit([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0], Some(1.0));
    }

    #[test]
    fn pixels_beyond_the_fold_see_nothing() {
        let params = [1000.0, 1000.0, 800.0, 600.0, -0.3, 0.0, 0.0, 0.0];
        // The image radius is largest at the fold: 2/3 of 1.0541.
        let largest = 2.0 / 3.0 * (1.0f64 / 0.9).sqrt();
        let at = |radius: f64| OpenCv::<4>.unproject(&params, [800.0 + 1000.0 * radius, 600.0]);
        assert!(at(0.999999 * largest).is_some());
        assert_eq!(at(1.000001 * largest), None);
        assert_eq!(at(100.0), None);
        let [x, y, _] = at(0.5 * largest).unwrap();
        assert!((x - 0.3 * x.powi(3) - 0.5 * largest).abs() < 1e-15 && y == 0.0);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn wild_lenses_unproject(
            radial in prop::array::uniform2(-0.5..0.5f64), k3 in -0.2..0.2f64,
            denominator in prop::array::uniform3(-0.3..1.5f64),
            tangential in prop::array::uniform2(-2e-3..2e-3f64),
            fraction in 0.0..0.95f64, azimuth in -3.2..3.2f64,
        ) {
            let lens = [
                radial[0], radial[1], tangential[0], tangential[1], k3, denominator[0], denominator[1], denominator[2],
            ];
            let params = [&[700.0, 710.0, 800.0, 600.0][..], &lens].concat();
            let edge = OpenCv::<8>.monotonic_limit(&params).unwrap_or(1.4).min(1.4);
            let r = (fraction * edge).tan();
            let point = [r * azimuth.cos(), r * azimuth.sin(), 1.0];
            // Tangential terms shift the fold; points that they put beyond it have no unique answer.
            let folds = |r: f64| {
                let slope = distort::linearize_distortion::<f64, 8>(&lens, r * azimuth.cos(), r * azimuth.sin());
                let [[a, b], [c, d]] = slope.d_plane;
                a * d - b * c < 0.02
            };
            prop_assume!(!(0..=20).any(|i| folds(r * f64::from(i) / 20.0)));
            let pixel = OpenCv::<8>.project(&params, point).unwrap();
            let ray = OpenCv::<8>.unproject(&params, pixel);
            prop_assert!(ray.is_some(), "{params:?} {point:?}");
            let [x, y, _] = ray.unwrap();
            prop_assert!((x - point[0]).hypot(y - point[1]) < 1e-11 * (1.0 + r * r), "{params:?} {point:?} {x} {y}");
        }
    }
}
