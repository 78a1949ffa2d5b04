//! Cameras whose images of one frame were taken at different times, told from a target that moves.

use std::fmt;
use std::str::FromStr;

use boresight_adjust::{AdjustOptions, TimeOffset, Timed, adjust_times};
use boresight_data::{Calibration, Dataset, Finding, Scene, Severity};

use crate::choices::BadChoice;
use crate::error::Error;

/// What becomes of cameras whose images are late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeOffsetChoice {
    /// Images of one frame are taken as of one instant; offsets that matter are told.
    #[default]
    Hold,
    /// Offsets are estimated with everything else.
    Solve,
}

impl fmt::Display for TimeOffsetChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Hold => "hold",
            Self::Solve => "solve",
        })
    }
}

impl FromStr for TimeOffsetChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        match text {
            "hold" => Ok(Self::Hold),
            "solve" => Ok(Self::Solve),
            _ => Err(BadChoice { value: text.to_owned(), takes: "hold, solve" }),
        }
    }
}

/// An offset in which the target moves by less in the image does no harm, in pixels.
const HARMLESS_PX: f64 = 0.05;
/// How many sigmas tell an offset from none.
const CERTAIN_SIGMAS: f64 = 4.0;

/// The long texts of findings about time offsets, each with its code.
pub(crate) const TIME_OFFSET_TEXTS: &[(&str, &str)] = &[
    (
        "time-offset",
        "What it means: where the target moves, a camera sees it where it is some time later, or earlier, than where the\n\
         reference camera sees it, although their images are of the same frame. The time is told with its sigma.\n\n\
         Why it matters: images of one frame are taken as of one instant, so that what the target moves in between becomes an\n\
         error of the rig, and of the lenses too.\n\n\
         How to fix it: estimate the offset with --time-offset solve, or time_offset = \"solve\" in [options] of the job;\n\
         trigger the cameras together; or hold the target still for each image.",
    ),
    (
        "time-offset-not-told",
        "What it means: offsets in time between cameras were to be estimated, and the data do not tell them.\n\n\
         Why it matters: images of one frame were taken as of one instant; if they are not, the rig between the cameras is off.\n\n\
         How to fix it: take images in quick succession, with time stamps or [input] frame_times, while the target moves in view of\n\
         both cameras.",
    ),
];

/// What came of looking for time offsets.
#[derive(Debug, Default)]
pub(crate) struct TimeOffsets {
    /// The calibration with the offsets, where they were asked for and are told.
    pub calibration: Option<Calibration>,
    /// What is to be said.
    pub findings: Vec<Finding>,
}

/// Looks for time offsets between the cameras of a calibration without them, whose frames have times.
pub(crate) fn look(
    dataset: &Dataset,
    seed: &Scene,
    held: &Calibration,
    choice: TimeOffsetChoice,
    options: &AdjustOptions,
) -> Result<TimeOffsets, Error> {
    let options = AdjustOptions { checkpoint: None, ..options.clone() };
    let timed = match (adjust_times(dataset, seed, &held.scene, &options), choice) {
        (Ok(timed), _) => timed,
        // Who did not ask for offsets has a calibration, whatever became of looking for them.
        (Err(_), TimeOffsetChoice::Hold) => None,
        (Err(error), TimeOffsetChoice::Solve) => return Err(error.into()),
    };
    let timed = timed.filter(|timed| timed.calibration.solve.converged && !timed.offsets.is_empty());
    let reference = held.scene.rig.reference().map_or("", |id| dataset.cameras[id].name.as_str());
    let name = |offset: &TimeOffset| dataset.cameras[offset.camera].name.as_str();
    Ok(match (timed, choice) {
        (None, TimeOffsetChoice::Hold) => TimeOffsets::default(),
        (None, TimeOffsetChoice::Solve) => {
            let findings = vec![not_told(reference)];
            TimeOffsets { calibration: None, findings }
        }
        (Some(Timed { offsets, .. }), TimeOffsetChoice::Hold) => {
            let findings = offsets.iter().filter(|offset| matters(offset)).map(|offset| Finding {
                code: TIME_OFFSET_TEXTS[0].0.to_owned(),
                severity: Severity::Caution,
                place: name(offset).to_owned(),
                message: describe(offset, reference, name(offset)),
                measured: Some(1e3 * offset.offset_s),
                limit: Some(1e3 * CERTAIN_SIGMAS * offset.sigma_s),
                fix: "--time-offset solve estimates it; or trigger the cameras together, or hold the target still"
                    .to_owned(),
            });
            TimeOffsets { calibration: None, findings: findings.collect() }
        }
        (Some(Timed { calibration, offsets }), TimeOffsetChoice::Solve) => {
            let findings = offsets.iter().filter(|offset| matters(offset)).map(|offset| Finding {
                code: TIME_OFFSET_TEXTS[0].0.to_owned(),
                severity: Severity::Note,
                place: name(offset).to_owned(),
                message: format!("{}; this is estimated and used", describe(offset, reference, name(offset))),
                measured: Some(1e3 * offset.offset_s),
                limit: None,
                fix: "trigger the cameras together, or correct the stamps by this much".to_owned(),
            });
            TimeOffsets { findings: findings.collect(), calibration: Some(calibration) }
        }
    })
}

/// Tells whether an offset is certain and does harm.
fn matters(offset: &TimeOffset) -> bool {
    offset.offset_s.abs() > CERTAIN_SIGMAS * offset.sigma_s && offset.shift_px > HARMLESS_PX
}

/// Says how far a camera is from the reference camera in time.
fn describe(offset: &TimeOffset, reference: &str, name: &str) -> String {
    let [time_ms, sigma_ms] = [offset.offset_s.abs(), offset.sigma_s].map(|time_s| 1e3 * time_s);
    let word = if offset.offset_s < 0.0 { "earlier" } else { "later" };
    let decimals = if sigma_ms < 0.05 { 2 } else { 1 };
    format!(
        "{reference} and {name} are {time_ms:.decimals$} ± {sigma_ms:.decimals$} ms apart: {name} took its images of the \
         same frames {word}, while the target moved by {:.2} px",
        offset.shift_px
    )
}

fn not_told(reference: &str) -> Finding {
    Finding {
        code: TIME_OFFSET_TEXTS[1].0.to_owned(),
        severity: Severity::Caution,
        place: reference.to_owned(),
        message: "time offsets between cameras were to be estimated, and nothing tells them: too few frames with times are \
                  close enough to their neighbours and shared by cameras"
            .to_owned(),
        measured: None,
        limit: None,
        fix: "take images in quick succession, with time stamps or [input] frame_times, while the target moves".to_owned(),
    }
}

#[cfg(test)]
#[path = "time_offset_tests.rs"]
mod tests;
