//! What every registered lens model is held to. [`registry`](crate::registry) makes a test of each
//! function here for each model.

use std::collections::BTreeSet;

use boresight_geometry::{Dual, Vector3};
use proptest::prelude::*;

use crate::{Camera, CameraModel, Error, MAX_LOCAL, MAX_PARAMS, Model, ParamGroup};

/// Makes the conformance tests of one model.
macro_rules! conformance_tests {
    ($model:ty) => {
        crate::conformance::conformance_tests!($model:
            names_are_consistent, core_is_affine, derivatives_match_differences,
            linearize_matches_duals, local_support_is_that_of_linearize, backward_axis_is_outside, unproject_inverts_project,
            project_inverts_unproject, random_points_return, monotonic_limit_matches_a_scan,
            undistorted_follows_its_core, camera_checks_parameters);
    };
    ($model:ty: $($test:ident),*) => {
        $(#[test]
        fn $test() {
            crate::conformance::$test::<$model>();
        })*
    };
}
pub(crate) use conformance_tests;

const IMAGE_SIZE: [u32; 2] = [1600, 1200];

pub(crate) fn names_are_consistent<M: CameraModel>()
where
    Model: From<M>,
{
    let model: Model = M::NAME.parse().unwrap();
    assert_eq!(model.name(), M::NAME);
    assert_eq!(Model::names().iter().filter(|&&name| name == M::NAME).count(), 1);
    assert!(!M::examples().is_empty());
    for (lens, params) in M::examples() {
        let names = lens.param_names();
        assert_eq!(names.len(), lens.param_count());
        assert_eq!(lens.param_groups().len(), lens.param_count());
        assert_eq!(params.len(), lens.param_count());
        assert_eq!(names[..4], ["fx", "fy", "cx", "cy"]);
        assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len());
        assert!(params.len() <= MAX_PARAMS || lens.local_support().is_some());
        let configured = Model::from(lens);
        assert_eq!(configured.param_count(), params.len());
        assert_eq!(configured.to_string().parse(), Ok(configured));
        let is_configured = configured.configuration().is_some();
        assert_eq!(is_configured, M::CONFIGURATION.is_some());
        assert!(is_configured || configured == model);
    }
}

pub(crate) fn core_is_affine<M: CameraModel>() {
    for_each_point::<M>(|lens, params, point| {
        let pixel = lens.project(params, point).unwrap();
        let mut unit = params.to_vec();
        unit[..4].copy_from_slice(&[1.0, 1.0, 0.0, 0.0]);
        let plane = lens.project(&unit, point).unwrap();
        // The same numbers through the same operations: exact.
        assert_eq!(pixel, [params[0] * plane[0] + params[2], params[1] * plane[1] + params[3]]);
    });
}

pub(crate) fn derivatives_match_differences<M: CameraModel>() {
    for_each_point::<M>(|lens, params, point| {
        let linear = linearize(&lens, params, point);
        let pixel = lens.project(params, point).unwrap();
        // The closed form and the projection may round differently.
        close(linear.pixel, pixel, 1e-14, params[0]);
        let depth = Vector3::from(point).norm();
        for axis in 0..3 {
            let moved = |step: f64| {
                let mut point = point;
                point[axis] += step * depth;
                lens.project(params, point).unwrap()
            };
            let difference = difference(moved).map(|d| d / depth);
            // Splines of low order are not smooth enough across cells for differences of high order.
            let reaches_over = lens.local_support().is_some() && {
                let cell = |step: f64| {
                    let mut point = point;
                    point[axis] += step * depth;
                    lens.linearize_locally(params, point).unwrap().first
                };
                cell(-3.0 * STEP) != cell(0.0) || cell(3.0 * STEP) != cell(0.0)
            };
            if !reaches_over {
                close(linear.by_point(axis), difference, 1e-9, params[0] / depth);
            }
        }
        for (i, group) in lens.param_groups().into_iter().enumerate().skip(4) {
            // A pupil moves by a length, which counts against the distance.
            let unit = if group == ParamGroup::Pupil { depth } else { 1.0 };
            let moved = |step: f64| {
                let mut params = params.to_vec();
                params[i] += step * unit;
                lens.project(&params, point).unwrap()
            };
            let difference = difference(moved).map(|d| d / unit);
            close(linear.by_lens(i - 4), difference, 1e-9, params[0] / unit);
        }
    });
}

pub(crate) fn linearize_matches_duals<M: CameraModel>() {
    for_each_point::<M>(|lens, params, point| {
        let linear = linearize(&lens, params, point);
        let mut dual = Linear::new(params.len() - 4);
        let [u, v] = &mut dual.d_lens;
        dual.pixel = linearize_one_by_one(&lens, params, point, &mut dual.d_point, [u, v]);
        let scale = params[0] / Vector3::from(point).norm();
        for axis in 0..3 {
            close(linear.by_point(axis), dual.by_point(axis), 1e-12, scale);
        }
        for i in 0..params.len() - 4 {
            close(linear.by_lens(i), dual.by_lens(i), 1e-12, params[0]);
        }
        close(linear.pixel, dual.pixel, 1e-14, params[0]);
    });
}

pub(crate) fn local_support_is_that_of_linearize<M: CameraModel>() {
    for_each_point::<M>(|lens, params, point| {
        let Some(support) = lens.local_support() else {
            assert!(lens.linearize_locally(params, point).is_none());
            return;
        };
        assert_eq!(params.len(), 4 + 2 * support.columns * support.rows);
        assert!(support.side * support.side <= MAX_LOCAL);
        let whole = linearize(&lens, params, point);
        let local = lens.linearize_locally(params, point).unwrap();
        assert_eq!((local.pixel, local.d_point), (whole.pixel, whole.d_point));
        let mut d_lens = [vec![0.0; params.len() - 4], vec![0.0; params.len() - 4]];
        for k in 0..support.side * support.side {
            for row in 0..2 {
                d_lens[row][support.param(local.first[0], k, row) - 4] = local.weights[k] * params[row];
            }
        }
        assert_eq!(d_lens, whole.d_lens);
    });
}

pub(crate) fn backward_axis_is_outside<M: CameraModel>() {
    for (lens, params) in M::examples() {
        for point in [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [f64::NAN; 3]] {
            assert_eq!(lens.project(&params, point), None, "{point:?}");
            let mut linear = Linear::new(params.len() - 4);
            let [u, v] = &mut linear.d_lens;
            assert_eq!(lens.linearize(&params, point, &mut linear.d_point, [u, v]), None);
        }
        for pixel in [[f64::NAN, 0.0], [0.0, f64::INFINITY]] {
            assert_eq!(lens.unproject(&params, pixel), None, "{pixel:?}");
        }
    }
}

pub(crate) fn unproject_inverts_project<M: CameraModel>() {
    for_each_point::<M>(|lens, params, point| {
        let pixel = lens.project(params, point).unwrap();
        let ray = lens.unproject(params, pixel).unwrap_or_else(|| panic!("{params:?} {point:?} {pixel:?}"));
        let angle = angle_between(ray, point);
        // One unit in the last place of a pixel coordinate is 2e-13 px, and `for_each_point` keeps
        // off the fold, where a pixel says little about the angle.
        assert!(angle < 1e-12, "{} {params:?} {point:?}: {angle:e}", M::NAME);
    });
}

pub(crate) fn project_inverts_unproject<M: CameraModel>() {
    for (lens, params) in M::examples() {
        let mut found = 0;
        for column in 0..=40 {
            for row in 0..=30 {
                let pixel = [40.0 * f64::from(column), 40.0 * f64::from(row)];
                let Some(ray) = lens.unproject(&params, pixel) else { continue };
                found += 1;
                let back = lens.project(&params, ray).unwrap();
                let error = (back[0] - pixel[0]).hypot(back[1] - pixel[1]);
                assert!(error < 1e-9, "{} {params:?} {pixel:?}: {error:e}", M::NAME);
                if let Some(limit) = lens.monotonic_limit(&params) {
                    assert!(angle_between(ray, [0.0, 0.0, 1.0]) <= limit);
                }
            }
        }
        assert!(found > 100, "{} {params:?}: only {found} pixels see anything", M::NAME);
    }
}

pub(crate) fn random_points_return<M: CameraModel>() {
    for (lens, params) in M::examples() {
        let edge = field_edge(&lens, &params);
        proptest!(ProptestConfig::with_cases(200), |(
            fraction in 0.0..1.0f64, azimuth in -3.2..3.2f64, distance in 1e-3..1e3f64
        )| {
            let point = direction(edge * fraction, azimuth).map(|x| x * distance);
            let pixel = lens.project(&params, point).unwrap();
            let ray = lens.unproject(&params, pixel).unwrap();
            prop_assert!(angle_between(ray, point) < 1e-12);
        });
    }
}

pub(crate) fn monotonic_limit_matches_a_scan<M: CameraModel>() {
    for (lens, mut params) in M::examples() {
        // The radial part alone: whatever breaks the symmetry is set aside.
        use ParamGroup::{Tangential, ThinPrism, Tilt};
        for (param, group) in params.iter_mut().zip(lens.param_groups()) {
            if matches!(group, Tangential | ThinPrism | Tilt) {
                *param = 0.0;
            }
        }
        let radius = |theta: f64| {
            let pixel = lens.project(&params, [theta.sin(), 0.0, theta.cos()])?;
            Some((pixel[0] - params[2]) / params[0])
        };
        let limit = lens.monotonic_limit(&params);
        const SCAN_STEP: f64 = 1e-3;
        let scanned = (1..3200)
            .map(|i| SCAN_STEP * f64::from(i))
            .take_while(|&theta| limit.is_some() || theta < 1.55)
            .map_while(|theta| Some((theta, radius(theta)?, radius(theta + SCAN_STEP)?)))
            .find(|(_, near, far)| far <= near)
            .map(|(theta, ..)| theta);
        match (limit, scanned) {
            (Some(limit), Some(scanned)) => {
                assert!((limit - scanned).abs() <= SCAN_STEP, "{limit} {scanned}")
            }
            (limit, scanned) => assert_eq!(limit, scanned, "{} {params:?}", M::NAME),
        }
    }
}

pub(crate) fn undistorted_follows_its_core<M: CameraModel>() {
    let core = [1000.0, 1010.0, 800.0, 600.0];
    for (lens, _) in M::examples() {
        assert_eq!(lens.undistorted(core)[..4], core);
        for params in [lens.undistorted(core), lens.wide(core)] {
            assert_eq!(params.len(), lens.param_count());
            assert_eq!(lens.project(&params, [0.0, 0.0, 2.0]), Some([800.0, 600.0]));
            // Near the axis every undistorted lens is a pinhole: what is left is of order 1e-3 cubed.
            let pixel = lens.project(&params, [2e-3, -2e-3, 2.0]).unwrap();
            assert!((pixel[0] - 801.0).abs() < 1e-6 && (pixel[1] - 598.99).abs() < 1e-6, "{pixel:?}");
        }
    }
}

pub(crate) fn camera_checks_parameters<M: CameraModel>()
where
    Model: From<M>,
{
    let (lens, params) = M::examples().swap_remove(0);
    let model = Model::from(lens);
    let need = params.len();
    for found in [0, need - 1, need + 1] {
        let error = Camera::new(model, vec![1.0; found], IMAGE_SIZE).unwrap_err();
        assert_eq!(error, Error::ParamCount { model: M::NAME, found, need });
        assert_eq!(
            error.to_string(),
            format!("lens model {} takes {need} parameters, {found} are given", M::NAME)
        );
    }
    for (i, value) in [(0, -1.0), (1, 0.0), (2, f64::NAN), (need - 1, f64::INFINITY)] {
        let mut params = params.clone();
        params[i] = value;
        let error = Camera::new(model, params, IMAGE_SIZE).unwrap_err();
        assert!(matches!(error, Error::BadParam { name, .. } if name == model.param_names()[i]));
    }
    assert!(Camera::new(model, params, IMAGE_SIZE).is_ok());
}

/// Calls `check` with every example and points over its field, the axis and the edge included.
fn for_each_point<M: CameraModel>(check: impl Fn(M, &[f64], [f64; 3])) {
    for (lens, params) in M::examples() {
        let edge = field_edge(&lens, &params);
        for fraction in [0.0, 1e-9, 1e-6, 1e-3, 0.009, 0.011, 0.1, 0.3, 0.5, 0.8, 0.95, 1.0] {
            for turn in 0..13 {
                let distance = [0.02, 1.0, 30.0][turn % 3];
                let azimuth = std::f64::consts::TAU * turn as f64 / 12.0;
                check(lens, &params, direction(edge * fraction, azimuth).map(|x| x * distance));
            }
        }
    }
}

/// Returns the angle off axis, in radians, up to which tests go: 1.1 times the distance of the
/// image's sides, and off any fold.
fn field_edge<M: CameraModel>(lens: &M, params: &[f64]) -> f64 {
    let in_field = |theta: f64| {
        (0..12).all(|turn| {
            let point = direction(theta, std::f64::consts::TAU * f64::from(turn) / 12.0);
            let Some([u, v]) = lens.project(params, point) else { return false };
            (u - 800.0).abs() < 880.0 && (v - 600.0).abs() < 660.0
        })
    };
    let fold = lens.monotonic_limit(params).unwrap_or(f64::INFINITY);
    (1..300)
        .map(|i| 0.01 * f64::from(i))
        .take_while(|&theta| theta < 0.9 * fold && in_field(theta))
        .last()
        .unwrap()
}

/// Returns the unit vector at an angle off axis and an azimuth, both in radians.
fn direction(theta: f64, azimuth: f64) -> [f64; 3] {
    [theta.sin() * azimuth.cos(), theta.sin() * azimuth.sin(), theta.cos()]
}

/// Returns the angle between two directions in radians, exact for small ones.
fn angle_between(a: [f64; 3], b: [f64; 3]) -> f64 {
    let (a, b) = (Vector3::from(a), Vector3::from(b));
    a.cross(&b).norm().atan2(a.dot(&b))
}

/// A pixel with all its derivatives, which own their memory.
struct Linear {
    pixel: [f64; 2],
    d_point: [[f64; 3]; 2],
    d_lens: [Vec<f64>; 2],
}

impl Linear {
    fn new(n_lens: usize) -> Self {
        // Filled with NaN, so that an entry left out shows.
        let d_lens = [vec![f64::NAN; n_lens], vec![f64::NAN; n_lens]];
        Self { pixel: [f64::NAN; 2], d_point: [[f64::NAN; 3]; 2], d_lens }
    }

    fn by_point(&self, axis: usize) -> [f64; 2] {
        [self.d_point[0][axis], self.d_point[1][axis]]
    }

    fn by_lens(&self, i: usize) -> [f64; 2] {
        [self.d_lens[0][i], self.d_lens[1][i]]
    }
}

fn linearize<M: CameraModel>(lens: &M, params: &[f64], point: [f64; 3]) -> Linear {
    let mut linear = Linear::new(params.len() - 4);
    let [u, v] = &mut linear.d_lens;
    linear.pixel = lens.linearize(params, point, &mut linear.d_point, [u, v]).unwrap();
    linear
}

/// Differentiates the projection through dual numbers, one direction at a time.
fn linearize_one_by_one<M: CameraModel>(
    lens: &M,
    params: &[f64],
    point: [f64; 3],
    d_point: &mut [[f64; 3]; 2],
    d_lens: [&mut [f64]; 2],
) -> [f64; 2] {
    let mut params: Vec<Dual<f64, 1>> = params.iter().map(|&param| Dual::fixed(param)).collect();
    let mut point = point.map(Dual::<f64, 1>::fixed);
    for axis in 0..3 {
        point[axis].derivative = [1.0];
        let by_axis = lens.project(&params, point).unwrap();
        point[axis].derivative = [0.0];
        [d_point[0][axis], d_point[1][axis]] = by_axis.map(|x| x.derivative[0]);
    }
    for i in 4..params.len() {
        params[i].derivative = [1.0];
        let by_param = lens.project(&params, point).unwrap();
        params[i].derivative = [0.0];
        [d_lens[0][i - 4], d_lens[1][i - 4]] = by_param.map(|x| x.derivative[0]);
    }
    lens.project(&params, point).unwrap().map(|x| x.value)
}

/// The step of central differences.
const STEP: f64 = 2e-3;

/// Returns the derivative at 0 of a pair by the central difference of sixth order.
fn difference(f: impl Fn(f64) -> [f64; 2]) -> [f64; 2] {
    let mut sum = [0.0; 2];
    for (k, weight) in [(1.0, 45.0), (2.0, -9.0), (3.0, 1.0)] {
        let (plus, minus) = (f(k * STEP), f(-k * STEP));
        for row in 0..2 {
            sum[row] += weight * (plus[row] - minus[row]);
        }
    }
    sum.map(|s| s / (60.0 * STEP))
}

#[track_caller]
fn close(a: [f64; 2], b: [f64; 2], relative: f64, scale: f64) {
    for row in 0..2 {
        let limit = relative * (scale + a[row].abs());
        assert!((a[row] - b[row]).abs() <= limit, "{} against {}, {limit:e} allowed", a[row], b[row]);
    }
}
