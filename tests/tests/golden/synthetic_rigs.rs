//! The synthetic rigs on which OpenCV's multi-view calibration was measured, solved jointly.

use boresight_adjust::{AdjustOptions, Regularization, Rejection, adjust};
use boresight_geometry::{Matrix3, Pose, Vector3};
use boresight_seed::{SeedOptions, seed};
use boresight_tests::conformance::conformance_file;
use boresight_tests::opencv_sets::read_rig;

/// Returns the mean distance of the cameras other than the first from where they truly are, in millimetres.
///
/// As the peers were measured: the norm of the difference of `cam_from_rig` translations.
fn mean_position_error_mm(name: &str) -> Option<f64> {
    let path = conformance_file(&format!("opencv/{name}.npz"))?;
    let (dataset, arrays) = read_rig(&path).unwrap();
    let options = SeedOptions { models: vec!["opencv5".parse().unwrap()], ..SeedOptions::default() };
    let seed = seed(&dataset, &options).unwrap();
    assert_eq!(seed.left_out, []);
    let options = AdjustOptions {
        rejection: Rejection::None,
        regularization: Regularization::None,
        ..AdjustOptions::default()
    };
    let calibration = adjust(&dataset, &seed.scene, &options, None).unwrap();
    assert!(calibration.solve.converged);
    let truth = |camera: usize| {
        let rotation = Matrix3::from_row_slice(&arrays.numbers("R")[9 * camera..9 * camera + 9]);
        Pose::from_matrix(
            &rotation,
            Vector3::from_column_slice(&arrays.numbers("T")[3 * camera..3 * camera + 3]),
        )
    };
    let cameras = calibration.scene.rig.cameras.as_slice();
    let errors: Vec<f64> = (1..cameras.len())
        .map(|camera| {
            (cameras[camera].as_ref().unwrap().cam_from_rig.translation - truth(camera).translation).norm()
                * 1e3
        })
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("{name}: RMS {:.6} px, errors {errors:.3?} mm, mean {mean:.4} mm", calibration.rms_px);
    Some(mean)
}

#[test]
fn four_cameras() {
    let Some(error_mm) = mean_position_error_mm("syn_rig4") else { return };
    assert!(error_mm <= 0.30, "{error_mm} mm");
}

#[test]
fn eight_cameras() {
    let Some(error_mm) = mean_position_error_mm("syn_rig8") else { return };
    assert!(error_mm <= 0.31, "{error_mm} mm");
}
