//! What is doubtful about a robot's calibration once it is made.

use std::collections::BTreeSet;

use boresight_adjust::{EstimatedNoise, HeldOut};
use boresight_data::{Calibration, Dataset, Finding, FrameId, Id as _, Mounting, Severity};
use boresight_io::{RobotAxes, RobotInput};

use super::compare::{mean, median};
use super::{FrameTold, MethodFigures, NOISE_ESTIMATED, PlainAnswer};

/// How many times better the other mounting must fit to be told.
const BETTER_MOUNTING: f64 = 3.0;
/// The share of the target's distance by which frames left out may be missed. Of
/// the recorded robots the worst has 0.013.
const MISFIT_SHARE: f64 = 0.03;
/// By how many degrees a robot's turns may be off about each axis: of the recorded robots the worst has 0.27.
const MISFIT_DEG: f64 = 1.0;
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

/// Tells that left-out frames are missed, or that the robot turns otherwise than it says, by more than robots do.
pub(super) fn of_misfit(
    answer: &MethodFigures,
    frames: &[FrameTold],
    noise: Option<&EstimatedNoise>,
) -> Option<Finding> {
    let distances: Vec<f64> = frames.iter().map(|told| told.rig_from_target.translation.norm()).collect();
    // A method without figures puts points where no ray of their pixels is.
    let missed_m = answer.figures.map_or(f64::INFINITY, |figures| figures.mean_m);
    let by_turns = || {
        let degrees = noise?.noise.rotation_rad.to_degrees();
        let what = format!("the robot's turns are off by {degrees:.1} degrees about each axis");
        (degrees > MISFIT_DEG).then(|| misfit_of(&what, Some(degrees), MISFIT_DEG))
    };
    misfit(missed_m, median(&distances), MISFIT_SHARE, "frames left out are missed").or_else(by_turns)
}

/// Returns the finding that something is missed by more than a share of the target's distance.
pub(super) fn misfit(missed_m: f64, distance_m: f64, limit: f64, what: &str) -> Option<Finding> {
    let share = missed_m / distance_m;
    let by = match share.is_finite() {
        true => format!("{:.1} mm, {:.1} % of the target's distance", 1e3 * missed_m, 100.0 * share),
        false => "any distance".to_owned(),
    };
    (share > limit).then(|| misfit_of(&format!("{what} by {by}"), share.is_finite().then_some(share), limit))
}

fn misfit_of(what: &str, measured: Option<f64>, limit: f64) -> Finding {
    Finding {
        code: "robot-misfit".to_owned(),
        severity: Severity::Fail,
        place: "robot".to_owned(),
        message: format!("{what}: the poses do not go with what the cameras saw"),
        measured,
        limit: Some(limit),
        fix: "Check that each row is of its own frame, that all are of one tool and a right-handed frame, and their \
              convention with `boresight robot poses`."
            .to_owned(),
    }
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
    let with = methods.iter().find(|method| method.name == NOISE_ESTIMATED)?.figures?.mean_m;
    let without =
        |method: &&MethodFigures| method.name.starts_with("adjusted") && !method.name.contains("noise");
    let means = methods.iter().filter(without);
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

/// The share of frames without a pose of a robot that moved above which it is more than a note.
const MANY_MUTE: f64 = 0.1;

/// Tells of frames without poses and poses without frames, of a robot whose poses are tied to frames.
pub(super) fn of_pairs(robot: &RobotInput, dataset: &Dataset) -> Option<Finding> {
    if !robot.frame_times_s.is_empty() {
        return of_moments(robot, dataset);
    }
    let seen = dataset.views.iter().map(|view| view.frame).collect::<BTreeSet<FrameId>>();
    let row_of = |frame: &FrameId| robot.row_of_frame.get(frame.index()).copied().flatten();
    let mute: Vec<FrameId> = seen.iter().copied().filter(|frame| row_of(frame).is_none()).collect();
    let used: BTreeSet<usize> = seen.iter().filter_map(row_of).collect();
    let idle: Vec<usize> = (0..robot.rows.len()).filter(|row| !used.contains(row)).collect();
    let first_mute = mute.first().map(|&frame| dataset.frames[frame].name.clone());
    let first_idle = idle.first().map(|&row| {
        let name = robot.rows[row].frame.as_deref().filter(|name| !name.is_empty());
        name.map_or_else(|| format!("row {}", row + 1), str::to_owned)
    });
    let such_as = |name: Option<String>| name.map_or_else(String::new, |name| format!(" (such as {name})"));
    (!mute.is_empty() || !idle.is_empty()).then(|| Finding {
        code: "robot-unpaired".to_owned(),
        severity: Severity::Note,
        place: "robot".to_owned(),
        message: format!(
            "{} of {} frames with corners{} have no pose of the robot and tell of lenses only; {} of {} poses{} are of \
             no frame with corners",
            mute.len(),
            seen.len(),
            such_as(first_mute),
            idle.len(),
            robot.rows.len(),
            such_as(first_idle)
        ),
        measured: Some((mute.len() + idle.len()) as f64),
        limit: Some(0.0),
        fix: "Check the names in the column `frame` of the poses against those that `boresight info` lists.".to_owned(),
    })
}

/// Tells of frames without a time, and of ones at whose time a robot that moved told no pose.
fn of_moments(robot: &RobotInput, dataset: &Dataset) -> Option<Finding> {
    let seen = dataset.views.iter().map(|view| view.frame).collect::<BTreeSet<FrameId>>();
    let has_time = |frame: &FrameId| robot.frame_times_s.get(frame.index()).copied().flatten().is_some();
    let untimed = seen.iter().filter(|frame| !has_time(frame)).count();
    let mute = seen.iter().filter(|frame| dataset.frames[**frame].base_from_flange.is_none()).count();
    let share = mute as f64 / seen.len().max(1) as f64;
    (mute > 0).then(|| Finding {
        code: "robot-unpaired".to_owned(),
        severity: if share > MANY_MUTE { Severity::Caution } else { Severity::Note },
        place: "robot".to_owned(),
        message: format!(
            "{mute} of {} frames with corners have no pose of the robot and tell of lenses only: {untimed} have no time, \
             and {} are of a time at which the robot told none, by the offset of the clocks that was found",
            seen.len(),
            mute - untimed.min(mute)
        ),
        measured: Some(share),
        limit: Some(MANY_MUTE),
        fix: "Record the robot's poses without gaps, from before the first image until after the last, and name each \
              frame in frame_times."
            .to_owned(),
    })
}

/// How much a position may be off for each metre before it is a reason for caution.
const STRETCH_CAUTION: f64 = 5e-4;

/// Tells that the robot's positions are off as a whole, and that the answer is for corrected ones.
pub(super) fn of_stretch(calibration: &Calibration, plain: Option<&PlainAnswer>) -> Option<Finding> {
    let stretch = calibration.scene.robot.as_ref()?.stretch?;
    let largest = stretch.matrix.singular_values().max();
    let scale = stretch.matrix.trace() / 3.0;
    let mean_m = plain.and_then(|plain| plain.method.figures).map_or(f64::NAN, |figures| figures.mean_m);
    Some(Finding {
        code: "robot-stretched".to_owned(),
        severity: if largest > STRETCH_CAUTION { Severity::Caution } else { Severity::Note },
        place: "robot".to_owned(),
        message: format!(
            "frames left out are foretold best with positions off by up to {:.2} mm a metre, a common scale of {:.5} in \
             it; the answer is for positions so corrected, and without_stretch of hand-eye.json, which foretells to \
             {:.3} mm, for positions as they are",
            1e3 * largest,
            1.0 + scale,
            1e3 * mean_m
        ),
        measured: Some(largest),
        limit: Some(STRETCH_CAUTION),
        fix: "Check the spacing of the target with a ruler and the robot's own calibration; correct positions by \
              `stretch` of hand-eye.json, or use `without_stretch` in place of `poses`."
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
        fix: "Touch points of the target with a tip that is known (touches and tip_mm in [robot]), or measure the height \
              above the base's origin and write height_m in [robot]."
            .to_owned(),
    })
}
