//! Views of a fisheye with corners up to 90 degrees off axis: OpenCV 5.0.0 gave up on 13 of the first 15 chunks.

use boresight_adjust::{AdjustOptions, adjust};
use boresight_seed::{SeedOptions, seed};
use boresight_tests::conformance::conformance_file;
use boresight_tests::npz::Npz;
use boresight_tests::opencv_sets::read_fisheye;

#[test]
fn all_chunks_are_calibrated_without_a_focal_length() {
    let Some(path) = conformance_file("opencv/syn_fisheye.npz") else { return };
    let arrays = Npz::read(&path).unwrap();
    let focal = arrays.numbers("K")[0];
    let n_chunks = arrays.shape("img")[0] / 20;
    let mut solved = 0;
    for chunk in 0..n_chunks {
        let dataset = read_fisheye(&path, 20 * chunk, 20).unwrap();
        let models = vec!["kannala-brandt4".parse().unwrap()];
        let seed = seed(&dataset, &SeedOptions { models, ..SeedOptions::default() }).unwrap();
        assert_eq!(seed.left_out, [], "chunk {chunk}");
        let calibration = adjust(&dataset, &seed.scene, &AdjustOptions::default(), None).unwrap();
        let camera = &calibration.scene.rig.cameras.as_slice()[0].as_ref().unwrap().camera;
        let n = calibration.uncertainty.names.len();
        let sigma = calibration.uncertainty.covariance[..=n][0].sqrt();
        println!(
            "chunk {chunk}: RMS {:.4} px, fx {:.3} ± {sigma:.3} for {focal}, {} rejected",
            calibration.rms_px,
            camera.params[0],
            calibration.rejected.len()
        );
        assert!(calibration.solve.converged, "chunk {chunk}");
        assert!((camera.params[0] - focal).abs() < 4.0 * sigma, "chunk {chunk}");
        // Beyond four sigmas lie 0.03 % of normal residuals.
        assert!(calibration.rejected.len() <= 8, "chunk {chunk}: {}", calibration.rejected.len());
        solved += 1;
    }
    println!("{solved} of {n_chunks} solved");
    assert_eq!((solved, n_chunks), (25, 25));
}
