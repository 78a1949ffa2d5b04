//! Cameras that are late, in front of a waved board with known truth.

use boresight_data::CameraId;
use boresight_io::Job;
use boresight_synthetic::{Recipe, Synthetic, Timing, simulate_moving};

use super::*;
use crate::{CalibrateOptions, Outcome, Watch, calibrate};

/// Two cameras at ten images a second, the second so much later than the stamps say.
fn waved(late_s: f64, frames: usize, seed: u64) -> Synthetic {
    let recipe = Recipe { frames, ..Recipe::stereo() };
    simulate_moving(
        &recipe,
        &Timing { period_s: 0.1, late_s: vec![0.0, late_s], line_delay_s: Vec::new(), speed: 1.0 },
        seed,
    )
}

fn calibrated(made: &Synthetic, time_offset: TimeOffsetChoice) -> Outcome {
    let options = CalibrateOptions { time_offset, ..CalibrateOptions::default() };
    calibrate(&Job::from(made.dataset.clone()), &options, &Watch::default()).unwrap()
}

fn found(outcome: &Outcome) -> Vec<&Finding> {
    outcome.findings.iter().filter(|finding| finding.code.starts_with("time-offset")).collect()
}

/// How far the second camera's centre is from the truth, in millimetres.
fn error_mm(outcome: &Outcome, made: &Synthetic) -> f64 {
    let place = |scene: &Scene| scene.rig.cameras[CameraId(1)].as_ref().unwrap().cam_from_rig;
    1e3 * (place(&outcome.calibration.scene).translation - place(&made.truth).translation).norm()
}

#[test]
#[allow(clippy::print_stdout, reason = "a test says what it measured")]
fn an_offset_of_twenty_milliseconds_is_recovered_to_one() {
    for truth_ms in [20.0, -20.0] {
        let made = waved(1e-3 * truth_ms, 120, 3);
        let solved = calibrated(&made, TimeOffsetChoice::Solve);
        let camera = solved.calibration.scene.rig.cameras[CameraId(1)].as_ref().unwrap();
        let sigma_ms = 1e3 * solved.calibration.uncertainty.sigma("cam1.time_offset_s").unwrap();
        let off_ms = 1e3 * camera.time_offset_s - truth_ms;
        let unseen = solved.calibration.held_out.as_ref().unwrap();
        println!(
            "{truth_ms} ms: off by {off_ms:.4} ± {sigma_ms:.4} ms, RMS {:.4} px, {:.3} mm, held out {:.3} times",
            solved.calibration.rms_px,
            error_mm(&solved, &made),
            unseen.ratio
        );
        assert!(off_ms.abs() < 1.0 && off_ms.abs() < 4.0 * sigma_ms, "{off_ms} ± {sigma_ms}");
        // Noise alone leaves the root of two times its sigma, less what the unknowns take up.
        assert!((solved.calibration.rms_px / (0.2 * 2f64.sqrt()) - 1.0).abs() < 0.02);
        assert!(unseen.ratio < 1.1, "{unseen:?}");
        assert!(error_mm(&solved, &made) < 0.3);

        let held = calibrated(&made, TimeOffsetChoice::Hold);
        let findings = found(&held);
        let [finding] = findings[..] else { panic!("{findings:?}") };
        println!(
            "  {}; held: RMS {:.4} px, {:.3} mm",
            finding.message,
            held.calibration.rms_px,
            error_mm(&held, &made)
        );
        assert!(finding.severity == Severity::Caution && finding.message.contains("cam0 and cam1 are "));
        assert!((finding.measured.unwrap() - truth_ms).abs() < 1.0, "{finding:?}");
        assert!(finding.fix.contains("--time-offset solve"));
        assert_eq!(held.calibration.scene.rig.cameras[CameraId(1)].as_ref().unwrap().time_offset_s, 0.0);
        assert!(error_mm(&solved, &made) < error_mm(&held, &made));
    }
}

#[test]
fn cameras_in_step_have_no_finding() {
    for seed in 1..4 {
        let made = waved(0.0, 60, seed);
        assert_eq!(found(&calibrated(&made, TimeOffsetChoice::Hold)), [] as [&Finding; 0]);
        let solved = calibrated(&made, TimeOffsetChoice::Solve);
        assert_eq!(found(&solved), [] as [&Finding; 0]);
        let late_s = solved.calibration.scene.rig.cameras[CameraId(1)].as_ref().unwrap().time_offset_s;
        let sigma_s = solved.calibration.uncertainty.sigma("cam1.time_offset_s").unwrap();
        assert!(late_s.abs() < 4.0 * sigma_s && sigma_s < 1e-3, "{late_s} ± {sigma_s}");
    }
}

#[test]
fn what_cannot_be_told_is_said() {
    let mut made = waved(0.02, 30, 1);
    made.dataset.frames.iter_mut().for_each(|frame| frame.time_ns = None);
    assert_eq!(found(&calibrated(&made, TimeOffsetChoice::Hold)), [] as [&Finding; 0]);
    let solved = calibrated(&made, TimeOffsetChoice::Solve);
    let codes: Vec<&str> = found(&solved).iter().map(|finding| finding.code.as_str()).collect();
    assert_eq!(codes, ["time-offset-not-told"]);
}
