//! Cameras and rows whose images of one frame were taken at different times, told from a target that moves.

use std::fmt;
use std::str::FromStr;

use boresight_adjust::{
    AdjustOptions, Clock, LEAST_FRAMES, LineDelay, TimeOffset, TimeSearch, Timed, adjust_times,
    views_in_motion,
};
use boresight_data::{Calibration, CameraId, Dataset, Finding, Scene, Severity};

use crate::choices::BadChoice;
use crate::error::Error;
use crate::line_delay::{self, LineDelayChoice, LineDelayUse};

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

/// A time in which the target moves by less in the image does no harm, in pixels.
pub(crate) const HARMLESS_PX: f64 = 0.05;
/// How many sigmas tell a time from none.
pub(crate) const CERTAIN_SIGMAS: f64 = 4.0;

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

/// What came of looking for times of cameras and rows.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// The calibration with the times that were asked for, where they are told, or stated.
    pub calibration: Option<Calibration>,
    /// Those that were estimated.
    pub clocks: Vec<Clock>,
    /// What is to be said.
    pub findings: Vec<Finding>,
}

/// Looks for times of cameras and rows in a calibration without them, whose frames have times.
///
/// The seed has the line delays that are stated.
pub(crate) fn look(
    dataset: &Dataset,
    seed: &Scene,
    held: &Calibration,
    (offset_choice, delay_choice): (TimeOffsetChoice, &LineDelayChoice),
    options: &AdjustOptions,
) -> Result<Times, Error> {
    let options = AdjustOptions { checkpoint: None, ..options.clone() };
    let reference = held.scene.rig.reference();
    let cameras = dataset.cameras.ids().filter(|id| Some(*id) != reference);
    let offsets: Vec<Clock> = cameras.map(Clock::Offset).collect();
    let [mut asked, mut others] = delay_choice.clocks(dataset);
    // A lens of very many parameters has no place for rows of different times.
    let is_local = |id: CameraId| {
        let camera = held.scene.rig.cameras[id].as_ref();
        camera.is_some_and(|camera| camera.camera.model.local_support().is_some())
    };
    others.retain(|clock| !matches!(clock, Clock::LineDelay(id) if is_local(*id)));
    match offset_choice {
        TimeOffsetChoice::Solve => asked.extend(&offsets),
        TimeOffsetChoice::Hold => others.extend(&offsets),
    }
    let mut times = Times::default();
    let states_delay = seed.rig.cameras.iter().flatten().any(|camera| camera.line_delay_s != 0.0);
    if !asked.is_empty() || states_delay {
        let timed = adjust_times(dataset, seed, held, (&asked, TimeSearch::Estimate), &options)?;
        // Where rows have times of their own there is no way back to those that have not: that it did not converge is told.
        let has_delays = states_delay || asked.iter().any(|clock| matches!(clock, Clock::LineDelay(_)));
        let timed = timed.filter(|timed| has_delays || timed.calibration.solve.converged);
        check_delays(dataset, held, delay_choice, timed.as_ref())?;
        let has_offsets = timed.as_ref().is_some_and(|timed| !timed.offsets.is_empty());
        if offset_choice == TimeOffsetChoice::Solve && !has_offsets {
            times.findings.push(not_told(reference.map_or("", |id| &dataset.cameras[id].name)));
        }
        if let Some(timed) =
            timed.filter(|timed| has_offsets || !timed.line_delays.is_empty() || states_delay)
        {
            times.findings.extend(used(dataset, held, &timed));
            times.clocks = timed.clocks();
            times.calibration = Some(timed.calibration);
        }
    }
    // What was not asked for is looked for all the same; if rows cannot be told, perhaps cameras can.
    let start = times.calibration.as_ref().unwrap_or(held);
    let offsets_alone: Vec<Clock> =
        others.iter().filter(|clock| matches!(clock, Clock::Offset(_))).copied().collect();
    let mut attempts = vec![&others, &offsets_alone];
    // Without line delays both are the same, and so would be what comes of them.
    attempts.dedup();
    for looked_for in attempts.into_iter().filter(|clocks| !clocks.is_empty()) {
        let wanted = [&times.clocks[..], looked_for].concat();
        // Who did not ask has a calibration, whatever becomes of looking.
        let Ok(Some(timed)) = adjust_times(dataset, seed, start, (&wanted, TimeSearch::Look), &options)
        else {
            continue;
        };
        let are_told = timed.line_delays.iter().all(LineDelay::is_told);
        if are_told && timed.calibration.solve.converged && !timed.clocks().is_empty() {
            times.findings.extend(unused(dataset, held, &timed, looked_for));
            break;
        }
    }
    Ok(times)
}

/// Returns an error if line delays were asked for and are not told, or are stated where nothing is known to move.
fn check_delays(
    dataset: &Dataset,
    held: &Calibration,
    delay_choice: &LineDelayChoice,
    timed: Option<&Timed>,
) -> Result<(), Error> {
    for (camera, info) in dataset.cameras.enumerate() {
        if held.scene.rig.cameras[camera].is_none() {
            continue;
        }
        let told = timed.and_then(|timed| timed.line_delays.iter().find(|delay| delay.camera == camera));
        let need = match delay_choice.of(&info.name) {
            LineDelayUse::Hold | LineDelayUse::Given(0.0) => continue,
            LineDelayUse::Given(_) => 1,
            LineDelayUse::Solve => LEAST_FRAMES,
        };
        let moving = views_in_motion(dataset, &held.scene, camera);
        if moving < need {
            let timed = dataset.frames.iter().filter(|frame| frame.time_ns.is_some()).count();
            let (camera, frames) = (info.name.clone(), dataset.frames.len());
            return Err(Error::NoMotion { camera, timed, frames, moving, need });
        }
        if delay_choice.of(&info.name) == LineDelayUse::Solve {
            line_delay::check_told(told, &info.name)?;
        }
    }
    Ok(())
}

/// Returns what is to be said of times that were asked for and are used.
fn used(dataset: &Dataset, held: &Calibration, timed: &Timed) -> Vec<Finding> {
    let name = |camera: CameraId| dataset.cameras[camera].name.as_str();
    let reference = held.scene.rig.reference().map_or("", name);
    let offsets = timed.offsets.iter().filter(|offset| matters(offset)).map(|offset| Finding {
        code: TIME_OFFSET_TEXTS[0].0.to_owned(),
        severity: Severity::Note,
        place: name(offset.camera).to_owned(),
        message: format!("{}; this is estimated and used", describe(offset, reference, name(offset.camera))),
        measured: Some(1e3 * offset.offset_s),
        limit: None,
        fix: "trigger the cameras together, or correct the stamps by this much".to_owned(),
    });
    let delays = timed.line_delays.iter().filter(|delay| line_delay::matters(delay));
    offsets.chain(delays.map(|delay| line_delay::used(delay, name(delay.camera)))).collect()
}

/// Returns what is to be said of times that were looked for and are not used.
fn unused(dataset: &Dataset, held: &Calibration, timed: &Timed, looked_for: &[Clock]) -> Vec<Finding> {
    let name = |camera: CameraId| dataset.cameras[camera].name.as_str();
    let reference = held.scene.rig.reference().map_or("", name);
    let offsets = timed.offsets.iter().filter(|offset| looked_for.contains(&Clock::Offset(offset.camera)));
    let offsets = offsets.filter(|offset| matters(offset)).map(|offset| Finding {
        code: TIME_OFFSET_TEXTS[0].0.to_owned(),
        severity: Severity::Caution,
        place: name(offset.camera).to_owned(),
        message: describe(offset, reference, name(offset.camera)),
        measured: Some(1e3 * offset.offset_s),
        limit: Some(1e3 * CERTAIN_SIGMAS * offset.sigma_s),
        fix: "--time-offset solve estimates it; or trigger the cameras together, or hold the target still"
            .to_owned(),
    });
    let delays = timed.line_delays.iter();
    let delays = delays.filter(|delay| looked_for.contains(&Clock::LineDelay(delay.camera)));
    let delays = delays.filter(|delay| line_delay::matters(delay));
    offsets.chain(delays.map(|delay| line_delay::found(delay, name(delay.camera)))).collect()
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
