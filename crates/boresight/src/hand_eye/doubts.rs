//! What is doubtful about a robot's calibration once it is made.

use boresight_adjust::{EstimatedNoise, HeldOut};
use boresight_data::{Calibration, Dataset, Finding, Mounting, Severity};
use boresight_io::RobotAxes;

use super::MethodFigures;
use super::compare::{mean, median};

/// How many times better the other mounting must fit to be told.
const BETTER_MOUNTING: f64 = 3.0;
/// How many times the median a frame's error must be to be told.
const FRAME_OFF: f64 = 4.0;

/// Tells that the other mounting fits far better.
pub(super) fn of_mounting(mounting: Mounting, misfit_m: f64, other_m: Option<f64>) -> Option<Finding> {
    let ratio = misfit_m / other_m?.max(1e-12);
    (ratio > BETTER_MOUNTING).then(|| {
        let (is, may_be) = match mounting {
            Mounting::RigOnFlange => ("on the flange", "fixed"),
            Mounting::RigInBase => ("fixed", "on the flange"),
        };
        Finding {
            code: "robot-mounting".to_owned(),
            severity: Severity::Fail,
            place: "robot".to_owned(),
            message: format!("the poses fit {ratio:.0} times better with cameras {may_be} than {is}, as stated"),
            measured: Some(ratio),
            limit: Some(BETTER_MOUNTING),
            fix: "Correct `mount` of [robot], or read the poses inverted; `boresight robot poses` tries all readings."
                .to_owned(),
        }
    })
}

/// Tells that the robot's noise was estimated and not used.
pub(super) fn of_noise(
    methods: &[MethodFigures],
    noise: Option<&EstimatedNoise>,
    is_used: bool,
) -> Option<Finding> {
    if noise.is_none() || is_used {
        return None;
    }
    let with = methods.last()?.figures?.mean_m;
    let means = methods.iter().filter(|method| method.name.starts_with("adjusted"));
    let least = means.filter_map(|method| method.figures).map(|f| f.mean_m).fold(f64::INFINITY, f64::min);
    Some(Finding {
        code: "robot-noise-not-used".to_owned(),
        severity: Severity::Note,
        place: "robot".to_owned(),
        message: format!(
            "frames left out are foretold to {:.3} mm with noise of the robot and to {:.3} mm without",
            1e3 * with,
            1e3 * least
        ),
        measured: Some(with),
        limit: Some(least),
        fix: "Nothing needs to be done; more poses let the noise be told better.".to_owned(),
    })
}

/// Tells of frames that all others foretell far worse than each other.
pub(super) fn of_frames(dataset: &Dataset, held_out: &[HeldOut]) -> Vec<Finding> {
    let means: Vec<f64> = held_out.iter().map(|held_out| mean(&held_out.errors.distances_m)).collect();
    let usual = median(&means);
    let off =
        held_out.iter().zip(&means).filter(|(_, mean)| **mean > FRAME_OFF * usual && held_out.len() > 4);
    off.map(|(held_out, mean)| Finding {
        code: "robot-frame-off".to_owned(),
        severity: Severity::Caution,
        place: dataset.frames[held_out.frame].name.clone(),
        message: format!(
            "all other frames foretell it to {:.2} mm; {:.2} mm is usual",
            1e3 * mean,
            1e3 * usual
        ),
        measured: Some(*mean),
        limit: Some(FRAME_OFF * usual),
        fix: "Check the robot's pose of this frame, and take the frame out if it cannot be mended."
            .to_owned(),
    })
    .collect()
}

/// How much a position may be off for each metre before it is told.
const STRETCH_TOLD: f64 = 5e-4;

/// Tells that the robot's positions are off as a whole.
pub(super) fn of_stretch(calibration: &Calibration) -> Option<Finding> {
    let stretch = calibration.scene.robot.as_ref()?.stretch?;
    let largest = stretch.matrix.singular_values().max();
    let scale = stretch.matrix.trace() / 3.0;
    (largest > STRETCH_TOLD).then(|| Finding {
        code: "robot-stretched".to_owned(),
        severity: Severity::Caution,
        place: "robot".to_owned(),
        message: format!(
            "frames left out are foretold best with positions off by up to {:.2} mm a metre; a common scale of {:.5} \
             is part of it",
            1e3 * largest,
            1.0 + scale
        ),
        measured: Some(largest),
        limit: Some(STRETCH_TOLD),
        fix: "Check the spacing of the target with a ruler and the robot's own calibration; positions are to be \
              corrected by `stretch` of the result."
            .to_owned(),
    })
}

/// Tells that a four-axis robot's height was not given.
pub(super) fn of_height(axes: RobotAxes, height_m: Option<f64>) -> Option<Finding> {
    (axes == RobotAxes::Four && height_m.is_none()).then(|| Finding {
        code: "robot-height-open".to_owned(),
        severity: Severity::Caution,
        place: "robot".to_owned(),
        message: "the translation along the base's z axis is open and taken as zero".to_owned(),
        measured: None,
        limit: None,
        fix: "Touch the target or measure its height above the base's origin, and write height_m in [robot]."
            .to_owned(),
    })
}
