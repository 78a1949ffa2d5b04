//! The recorded left/right corners against OpenCV 5.0.0's converged answers (`real_results_cv5.0.0.json`).

use boresight_adjust::{AdjustOptions, Regularization, Rejection, adjust};
use boresight_camera::Model;
use boresight_data::{Calibration, Dataset, RejectionReason, Shape};
use boresight_seed::{SeedOptions, seed};
use boresight_tests::conformance::conformance_file;
use boresight_tests::opencv_sets::read_corners;

fn read(corners: &str, cameras: &[&str]) -> Option<Dataset> {
    let path = conformance_file(&format!("opencv/real_corners_{corners}_cv5.0.0.csv"))?;
    Some(read_corners(&path, cameras).unwrap())
}

fn plain() -> AdjustOptions {
    AdjustOptions {
        rejection: Rejection::None,
        regularization: Regularization::None,
        decrease_below: 1e-12,
        ..AdjustOptions::default()
    }
}

fn calibrate(dataset: &Dataset, options: &AdjustOptions) -> Calibration {
    let model: Model = "opencv5".parse().unwrap();
    let seed = seed(dataset, &SeedOptions { models: vec![model], ..SeedOptions::default() }).unwrap();
    assert_eq!(seed.left_out, []);
    let calibration = adjust(dataset, &seed.scene, options, None).unwrap();
    assert!(calibration.solve.converged, "{}", calibration.solve.stop);
    calibration
}

#[test]
fn each_camera_alone_matches_opencv() {
    // fx, fy, cx, cy of `classic5|left|5|tight` and `classic5|right|5|tight`.
    let expected = [
        ("left", 0.195512, [532.82521, 532.94445, 342.49237, 233.86121]),
        ("right", 0.207060, [537.45011, 536.96703, 327.58788, 248.88440]),
    ];
    for (camera, rms_px, core) in expected {
        let Some(dataset) = read("classic5", &[camera]) else { return };
        let calibration = calibrate(&dataset, &plain());
        let found = &calibration.scene.rig.cameras.as_slice()[0].as_ref().unwrap().camera.params;
        println!("{camera}: RMS {:.7}, {:?}", calibration.rms_px, &found[..4]);
        assert!((calibration.rms_px - rms_px).abs() <= 1e-5);
        for (found, expected) in found.iter().zip(core) {
            assert!((found - expected).abs() <= 0.002, "{camera}: {found} against {expected}");
        }
    }
}

#[test]
fn both_cameras_jointly_match_opencv() {
    let Some(dataset) = read("classic5", &["left", "right"]) else { return };
    let calibration = calibrate(&dataset, &plain());
    let right = calibration.scene.rig.cameras.as_slice()[1].as_ref().unwrap();
    let translation = right.cam_from_rig.translation;
    println!("joint: RMS {:.7}, T {:.7}", calibration.rms_px, translation.transpose());
    assert!((calibration.rms_px - 0.215111).abs() <= 1e-5);
    for (found, expected) in translation.iter().zip([-3.327072, 0.036799, -0.004729]) {
        assert!((found - expected).abs() <= 1e-4, "{found} against {expected}");
    }
}

#[test]
fn outliers_of_the_wide_window_are_rejected() {
    // The corners that a Cauchy loss leaves more than 1 px off, from `independent_lm.json`: (view, point).
    const LEFT: [(usize, u32); 11] =
        [(1, 0), (1, 9), (1, 18), (1, 27), (1, 36), (1, 45), (6, 44), (8, 26), (8, 44), (11, 17), (11, 44)];
    const RIGHT: [(usize, u32); 14] = [
        (0, 27),
        (0, 45),
        (1, 0),
        (1, 9),
        (1, 18),
        (1, 27),
        (1, 36),
        (1, 45),
        (4, 9),
        (4, 27),
        (4, 45),
        (6, 26),
        (6, 44),
        (11, 44),
    ];
    let (Some(mut dataset), Some(clean)) =
        (read("classic11", &["left", "right"]), read("classic5", &["left", "right"]))
    else {
        return;
    };
    // All corners that differ by more than a pixel between the two windows are the 12 + 14 outliers.
    let mut outliers = Vec::new();
    for (view_idx, (view, clean)) in dataset.views.iter().zip(&clean.views).enumerate() {
        for (a, b) in view.observations.iter().zip(&clean.observations) {
            if (a.pixel[0] - b.pixel[0]).hypot(a.pixel[1] - b.pixel[1]) > 1.0 {
                outliers.push((view_idx, a.point));
            }
        }
    }
    assert_eq!(outliers.len(), 26);
    for (camera, list) in [&LEFT[..], &RIGHT[..]].into_iter().enumerate() {
        for &(frame, point) in list {
            let is_known = outliers.iter().any(|&(view_idx, p)| {
                let view = &dataset.views[view_idx];
                (view.camera.0 as usize, view.frame.0 as usize, p.0) == (camera, frame, point)
            });
            assert!(is_known, "camera {camera} frame {frame} point {point}");
        }
    }
    dataset.targets = dataset
        .targets
        .iter()
        .cloned()
        .map(|mut t| {
            t.shape = Shape::Parabolic2;
            t
        })
        .collect();
    let calibration = calibrate(&dataset, &AdjustOptions::default());
    let found = outliers.iter().filter(|(view_idx, point)| {
        calibration.rejected.iter().any(|rejection| {
            (rejection.view_idx, rejection.point) == (*view_idx, *point)
                && matches!(rejection.reason, RejectionReason::Outlier { .. })
        })
    });
    let n_found = found.count();
    let focal =
        |camera: usize| calibration.scene.rig.cameras.as_slice()[camera].as_ref().unwrap().camera.params[0];
    println!(
        "rejected {} of 26, {} in all; fx {:.3}, {:.3}; shape {:?}",
        n_found,
        calibration.rejected.len(),
        focal(0),
        focal(1),
        calibration.scene.targets.as_slice()[0].shape_m
    );
    assert!(n_found >= 24, "{n_found} of 26");
    // Clean answers: classic5 jointly, with the same defaults.
    let mut clean = clean;
    clean.targets = dataset.targets.clone();
    let clean = calibrate(&clean, &AdjustOptions::default());
    for camera in 0..2 {
        let clean = clean.scene.rig.cameras.as_slice()[camera].as_ref().unwrap().camera.params[0];
        println!("camera {camera}: fx {:.3} against clean {clean:.3}", focal(camera));
        assert!((focal(camera) - clean).abs() <= 0.7, "fx {} against {clean}", focal(camera));
    }
}
