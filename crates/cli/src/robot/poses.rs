//! `boresight robot poses`: which convention do the poses follow?

use std::process::ExitCode;

use boresight::{CalibrateOptions, describe_reading};
use clap::Args;

use crate::arguments::InputArguments;
use crate::calibrate::tell_findings;
use crate::failure::Failure;
use crate::inputs;
use crate::streams::{answer, note};
use crate::table::{aligned, row};

use super::hand_eye::RobotArguments;

#[derive(Args, Debug)]
pub(crate) struct PosesArguments {
    #[command(flatten)]
    pub input: InputArguments,
    #[command(flatten)]
    pub robot: RobotArguments,
    /// How many readings to list
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub most: usize,
}

/// Lists the readings of the poses, the best first. Exit codes: 0 the stated one is the best, 1 another is by far, or none
/// fits.
pub(crate) fn run(arguments: &PosesArguments) -> Result<ExitCode, Failure> {
    let job = inputs::load_with_robot(&arguments.input, arguments.robot.overrides())?;
    let found = boresight::read_poses(&job, &CalibrateOptions::of_job(&job)?)?;
    let mut rows = vec![row(["reading", "left-out mm", "times the best"])];
    let best = found.readings.first().map_or(f64::NAN, |reading| reading.held_out_m);
    for (i, reading) in found.readings.iter().enumerate() {
        let is_stated = found.stated == Some(i);
        if i < arguments.most || is_stated {
            let mark = if is_stated { " (stated)" } else { "" };
            rows.push(vec![
                format!("{}{mark}", describe_reading(reading, &found.frames)),
                format!("{:.3}", 1e3 * reading.held_out_m),
                format!("{:.1}", reading.held_out_m / best),
            ]);
        }
    }
    answer(aligned(&rows).as_bytes())?;
    if let Some(reading) = found.readings.first() {
        note(&format!(
            "the data cannot tell this from {}, nor a tool that was active all the time from the flange",
            describe_reading(&reading.twin(), &found.frames)
        ));
    }
    let findings: Vec<_> = found.finding.into_iter().collect();
    tell_findings(&findings);
    Ok(ExitCode::from(u8::from(!findings.is_empty())))
}
