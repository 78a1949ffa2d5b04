use boresight_geometry::Vector6;

use super::*;
use crate::test_numbers::Normals;

fn camera() -> Camera {
    let params = vec![1200.0, 1190.0, 800.5, 610.0, -0.2, 0.05, 1e-3, -5e-4, 0.02];
    Camera::new("opencv5".parse().unwrap(), params, [1600, 1200]).unwrap()
}

/// A block of 60 x 40 x 30 mm, 0.5 m away.
const POINTS: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [0.06, 0.0, 0.0],
    [0.06, 0.04, 0.0],
    [0.0, 0.04, 0.0],
    [0.0, 0.0, 0.03],
    [0.06, 0.04, 0.03],
];

fn truth() -> Pose {
    Pose::from_rodrigues(Vector3::new(0.4, -0.3, 0.8), Vector3::new(0.03, -0.02, 0.5))
}

fn seen(
    camera: &Camera,
    points: &[[f64; 3]],
    noise: &mut dyn FnMut() -> f64,
    sigma_px: f64,
) -> Vec<SeenPoint> {
    let one = |&point_m: &[f64; 3]| {
        let pixel = camera.project(&(truth() * Vector3::from(point_m))).unwrap();
        SeenPoint { point_m, pixel: pixel.map(|x| x + sigma_px * noise()), sigma_px }
    };
    points.iter().map(one).collect()
}

#[test]
fn an_exact_view_gives_the_pose_from_a_start_nearby() {
    let points = seen(&camera(), &POINTS, &mut || 0.0, 0.1);
    let start = truth().perturbed(&Vector6::new(0.1, -0.1, 0.05, 0.01, 0.02, -0.03));
    let found = object_pose(&camera(), &points, &start, Loss::None, None).unwrap();
    let error = (found.cam_from_object * truth().inverse()).log();
    assert!(error.norm() < 1e-9 && found.rms_px() < 1e-7, "{error} {}", found.rms_px());
    assert_eq!(found.degrees_of_freedom, 6);
}

/// Compares the stated covariance with the scatter of noisy runs, pixels and lens perturbed alike.
fn check_scatter(n_points: usize) {
    let camera = camera();
    let lens_sigmas = [0.5, 0.5, 0.8, 0.8, 1e-3, 3e-3, 1e-4, 1e-4, 2e-3];
    let lens_covariance =
        DMatrix::from_fn(9, 9, |i, j| if i == j { lens_sigmas[i] * lens_sigmas[i] } else { 0.0 });
    let mut normals = Normals::new(5);
    let runs = 1500;
    let mut scatter = Matrix6::zeros();
    let mut stated = Matrix6::zeros();
    for _ in 0..runs {
        let mut true_camera = camera.clone();
        for (param, sigma) in true_camera.params.iter_mut().zip(lens_sigmas) {
            *param += sigma * normals.next();
        }
        let points = seen(&true_camera, &POINTS[..n_points], &mut || normals.next(), 0.1);
        let found = object_pose(&camera, &points, &truth(), Loss::None, Some(&lens_covariance)).unwrap();
        let error = (found.cam_from_object * truth().inverse()).log();
        scatter += error * error.transpose() / f64::from(runs);
        stated += found.covariance() / f64::from(runs);
    }
    for i in 0..6 {
        // The scatter of 1500 runs is itself known to 1.8 %; four sigmas of that.
        let ratio = (stated[(i, i)] / scatter[(i, i)]).sqrt();
        assert!((ratio - 1.0).abs() < 0.075, "{n_points} points, column {i}: {ratio}");
    }
    // Along the loosest direction too, where correlations matter.
    let loosest = stated.symmetric_eigen().eigenvectors.column(0).into_owned();
    let along = |matrix: &Matrix6<f64>| (loosest.transpose() * matrix * loosest)[0].sqrt();
    assert!((along(&stated) / along(&scatter) - 1.0).abs() < 0.075);
}

#[test]
fn stated_sigmas_are_the_scatter() {
    check_scatter(6);
    check_scatter(4);
}

#[test]
fn points_that_leave_the_pose_open_are_refused() {
    let line = [[0.0; 3], [0.01, 0.0, 0.0], [0.05, 0.0, 0.0], [0.06, 0.0, 0.0]];
    let points = seen(&camera(), &line, &mut || 0.0, 0.1);
    let error = assessed(&camera(), &points, truth(), None).unwrap_err();
    assert!(
        matches!(error, ObjectPoseError::Open { reciprocal_condition, .. } if reciprocal_condition < 1e-14)
    );
    let error = object_pose(&camera(), &points[..2], &truth(), Loss::None, None).unwrap_err();
    assert_eq!(error, ObjectPoseError::TooFewPoints { found: 2, need: 3 });
    let behind = Pose::new(truth().rotation, -truth().translation);
    let error = object_pose(&camera(), &points, &behind, Loss::None, None).unwrap_err();
    assert_eq!(error, ObjectPoseError::OutOfSight { index: 0 });
}
