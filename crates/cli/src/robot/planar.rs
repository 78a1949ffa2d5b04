//! `boresight robot planar`.

use std::path::PathBuf;
use std::process::ExitCode;

use boresight::{PLANAR_NAMES, PlanarMotion, planar, planar_to_json, read_planar_motions, verdict};
use clap::Args;

use crate::calibrate::{exit_code, tell_findings};
use crate::failure::{Failure, Reason};
use crate::figures::with_sigma;
use crate::streams::{answer, note};
use crate::table::{aligned, row};

#[derive(Args, Debug)]
pub(crate) struct PlanarArguments {
    /// Motions, JSON objects: {"T": s, "phi_l": rad/s, "phi_r": rad/s, "sm": [x m, y m, theta rad]}
    pub motions: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    pub json: bool,
}

/// Calibrates wheels, axle and sensor of a planar robot and prints them.
pub(crate) fn run(arguments: &PlanarArguments) -> Result<ExitCode, Failure> {
    let file = arguments.motions.display().to_string();
    let bytes = std::fs::read(&arguments.motions)
        .map_err(|error| Failure::new(Reason::Input, format!("{file}: cannot be read: {error}")))?;
    let motions: Vec<PlanarMotion> = read_planar_motions(&file, &bytes)?
        .into_iter()
        .map(|row| PlanarMotion {
            duration_s: row.duration_s,
            wheel_rad_per_s: [row.left_rad_per_s, row.right_rad_per_s],
            sensor_motion: row.sensor_motion,
        })
        .collect();
    let outcome = planar(&motions).map_err(|error| Failure::from(error).of(&file))?;
    let found = &outcome.robot;
    if arguments.json {
        answer(&planar_to_json(&outcome))?;
    } else {
        let mut rows = vec![row(["parameter", "value"])];
        for (i, name) in PLANAR_NAMES.iter().enumerate() {
            rows.push(vec![(*name).to_owned(), with_sigma(found.values[i], Some(found.sigmas[i]))]);
        }
        answer(aligned(&rows).as_bytes())?;
    }
    tell_findings(&outcome.findings);
    let [metres, radians] = found.median_residuals;
    note(&format!(
        "{} of {} intervals used; median residual {:.3} mm, {:.4} deg",
        found.used,
        outcome.given,
        1e3 * metres,
        radians.to_degrees()
    ));
    Ok(exit_code(verdict(&outcome.findings)))
}
