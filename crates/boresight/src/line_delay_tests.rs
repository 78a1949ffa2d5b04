//! Cameras that take their rows one after another, in front of a waved board with known truth.

use boresight_data::{Frame, FrameId, Id as _, View};
use boresight_io::Job;
use boresight_synthetic::{Recipe, Synthetic, Timing, simulate, simulate_moving};

use super::*;
use crate::{CalibrateOptions, Outcome, TimeOffsetChoice, Watch, calibrate};

/// A board waved before cameras at ten images a second.
fn waved(recipe: &Recipe, frames: usize, late_s: &[f64], line_delay_s: &[f64], seed: u64) -> Synthetic {
    let recipe = Recipe { frames, ..recipe.clone() };
    let timing =
        Timing { period_s: 0.1, late_s: late_s.to_vec(), line_delay_s: line_delay_s.to_vec(), speed: 1.0 };
    simulate_moving(&recipe, &timing, seed)
}

fn options(line_delay: &str) -> CalibrateOptions {
    CalibrateOptions { line_delay: line_delay.parse().unwrap(), ..CalibrateOptions::default() }
}

fn tried(made: &Synthetic, options: &CalibrateOptions) -> Result<Outcome, Error> {
    calibrate(&Job::from(made.dataset.clone()), options, &Watch::default())
}

fn calibrated(made: &Synthetic, line_delay: &str) -> Outcome {
    tried(made, &options(line_delay)).unwrap()
}

fn found(outcome: &Outcome) -> Vec<&Finding> {
    outcome.findings.iter().filter(|finding| finding.code == "rolling-shutter").collect()
}

/// A camera's line delay and its sigma, in microseconds.
fn delay_us(outcome: &Outcome, camera: usize) -> [f64; 2] {
    let id = CameraId::from_index(camera);
    let name = &outcome.dataset.cameras[id].name;
    let sigma_s = outcome.calibration.uncertainty.sigma(&format!("{name}.line_delay_s")).unwrap_or(f64::NAN);
    [outcome.calibration.scene.rig.cameras[id].as_ref().unwrap().line_delay_s, sigma_s].map(|s| 1e6 * s)
}

/// How far a camera's focal length is from the truth, in pixels.
fn focal_error_px(outcome: &Outcome, made: &Synthetic, camera: usize) -> f64 {
    let id = CameraId::from_index(camera);
    let focal = |scene: &Scene| scene.rig.cameras[id].as_ref().unwrap().camera.params[0];
    (focal(&outcome.calibration.scene) - focal(&made.truth)).abs()
}

#[test]
#[allow(clippy::print_stdout, reason = "a test says what it measured")]
fn twenty_microseconds_a_row_are_recovered() {
    for (truth_us, seed) in [(20.0, 3), (-20.0, 4)] {
        let made = waved(&Recipe::mono(), 100, &[], &[1e-6 * truth_us], seed);
        let solved = calibrated(&made, "solve");
        let [delay, sigma] = delay_us(&solved, 0);
        let held = calibrated(&made, "hold");
        let unseen = solved.calibration.held_out.as_ref().unwrap();
        println!(
            "{truth_us} us: {delay:.4} ± {sigma:.4} us; RMS {:.4} px, held out {:.3} times, focal length off by {:.3} px; \
             held: RMS {:.4} px, off by {:.3} px",
            solved.calibration.rms_px,
            unseen.ratio,
            focal_error_px(&solved, &made, 0),
            held.calibration.rms_px,
            focal_error_px(&held, &made, 0),
        );
        assert!(
            (delay - truth_us).abs() < 3.0 * sigma && sigma < 0.05 * truth_us.abs() / 3.0,
            "{delay} ± {sigma}"
        );
        assert!((delay / truth_us - 1.0).abs() < 0.05, "{delay}");
        // What is left is the noise that was put on.
        assert!((solved.calibration.uncertainty.noise_factor - 1.0).abs() < 0.02);
        assert!(unseen.ratio < 1.1, "{unseen:?}");
        assert_eq!(found(&solved).len(), 1);
        assert_eq!(found(&solved)[0].severity, Severity::Note);

        let findings = found(&held);
        let [finding] = findings[..] else { panic!("{findings:?}") };
        println!("  {}", finding.message);
        assert_eq!(finding.severity, Severity::Caution);
        assert!(finding.fix.contains("--line-delay solve"));
        assert!((finding.measured.unwrap() / truth_us - 1.0).abs() < 0.05, "{finding:?}");
        assert!(finding.limit.unwrap() > 0.0 && finding.limit.unwrap() < finding.measured.unwrap().abs());
        assert_eq!(delay_us(&held, 0)[0], 0.0);
    }
}

#[test]
fn a_global_shutter_has_no_finding() {
    for seed in 1..3 {
        let made = waved(&Recipe::mono(), 60, &[], &[], seed);
        assert_eq!(found(&calibrated(&made, "hold")), [] as [&Finding; 0]);
        let solved = calibrated(&made, "solve");
        assert_eq!(found(&solved), [] as [&Finding; 0]);
        let [delay, sigma] = delay_us(&solved, 0);
        assert!(delay.abs() < 4.0 * sigma && sigma < 0.5, "{delay} ± {sigma}");
    }
}

/// One camera of two rolls, and the other is late; each is told from the other, and a stated delay does as an estimated one.
#[test]
fn delays_and_offsets_are_told_apart() {
    let made = waved(&Recipe::stereo(), 60, &[0.0, 0.02], &[0.0, 20e-6], 5);
    let both = CalibrateOptions { time_offset: TimeOffsetChoice::Solve, ..options("solve,cam0=0") };
    let solved = tried(&made, &both).unwrap();
    let [delay, sigma] = delay_us(&solved, 1);
    assert!((delay - 20.0).abs() < (3.0 * sigma).min(1.0), "{delay} ± {sigma}");
    assert!(delay_us(&solved, 0)[0] == 0.0 && delay_us(&solved, 0)[1].is_nan());
    let late_s = |outcome: &Outcome| {
        outcome.calibration.scene.rig.cameras[CameraId(1)].as_ref().unwrap().time_offset_s
    };
    let sigma_s = solved.calibration.uncertainty.sigma("cam1.time_offset_s").unwrap();
    assert!((late_s(&solved) - 0.02).abs() < 4.0 * sigma_s, "{} ± {sigma_s}", late_s(&solved));

    let stated = CalibrateOptions { time_offset: TimeOffsetChoice::Solve, ..options("0,cam1=20e-6") };
    let stated = tried(&made, &stated).unwrap();
    assert_eq!(delay_us(&stated, 1)[0], 20.0);
    assert!((late_s(&stated) - 0.02).abs() < 4.0 * sigma_s);
    let rms_px = [&solved, &stated].map(|outcome| outcome.calibration.rms_px);
    assert!((rms_px[0] / rms_px[1] - 1.0).abs() < 1e-3, "{rms_px:?}");
    assert_eq!(found(&stated), [] as [&Finding; 0]);

    // What is held is looked for, with its camera's name; what is estimated beside it is no finding of the other kind.
    let held =
        tried(&made, &CalibrateOptions { time_offset: TimeOffsetChoice::Solve, ..options("hold") }).unwrap();
    let places: Vec<(&str, Severity)> =
        found(&held).iter().map(|finding| (finding.place.as_str(), finding.severity)).collect();
    assert_eq!(places, [("cam1", Severity::Caution)]);
}

#[test]
fn what_cannot_be_told_is_refused() {
    let mut made = waved(&Recipe::mono(), 30, &[], &[20e-6], 1);
    for choice in ["solve", "2e-5"] {
        let mut unstamped = made.clone();
        unstamped.dataset.frames.iter_mut().for_each(|frame| frame.time_ns = None);
        let error = tried(&unstamped, &options(choice)).unwrap_err();
        assert!(matches!(error, Error::NoMotion { timed: 0, frames: 30, moving: 0, .. }), "{error}");
        assert!(error.to_string().contains("0 of 30 frames have times"), "{error}");
        assert!(error.hint().is_some_and(|hint| hint.contains("frame_times")));
    }
    let error = tried(&made, &options("solve,cam7=0")).unwrap_err();
    assert!(matches!(&error, Error::UnknownCamera { name, .. } if name == "cam7"), "{error}");

    // Each frame an hour after the last: the stamps tell no motion.
    for (hour, frame) in made.dataset.frames.iter_mut().enumerate() {
        frame.time_ns = Some(hour as i64 * 3_600_000_000_000);
    }
    let error = tried(&made, &options("solve")).unwrap_err();
    assert!(matches!(error, Error::NoMotion { timed: 30, moving: 0, .. }), "{error}");
    assert_eq!(found(&calibrated(&made, "hold")), [] as [&Finding; 0]);

    // Held still at each of many places for five images: the neighbours tell that nothing moves.
    let still = simulate(&Recipe { frames: 12, ..Recipe::mono() }, 2);
    let mut made = still.clone();
    made.dataset.frames = Default::default();
    made.dataset.views.clear();
    for (frame, view) in still.dataset.views.iter().enumerate() {
        for again in 0..5 {
            let time_ns = Some((50 * frame + again) as i64 * 100_000_000);
            let id = FrameId::from_index(5 * frame + again);
            made.dataset.frames.push(Frame { name: format!("{frame}-{again}"), time_ns, ..Frame::default() });
            made.dataset.views.push(View { frame: id, ..view.clone() });
        }
    }
    let error = tried(&made, &options("solve")).unwrap_err();
    assert!(matches!(error, Error::SlowMotion { .. }), "{error}");
    assert_eq!(found(&calibrated(&made, "hold")), [] as [&Finding; 0]);
}

#[test]
fn choices_are_read_as_they_are_written() {
    for text in ["hold", "solve", "2e-5", "-2.96e-5", "solve,left=0e0,right=hold"] {
        let choice: LineDelayChoice = text.parse().unwrap();
        assert_eq!(choice.to_string(), text);
    }
    let choice: LineDelayChoice = "solve,left=0".parse().unwrap();
    assert_eq!([choice.of("left"), choice.of("right")], [LineDelayUse::Given(0.0), LineDelayUse::Solve]);
    for text in ["", "auto", "20", "nan", "left=", "2e-5s"] {
        assert!(text.parse::<LineDelayChoice>().is_err(), "{text}");
    }
}
