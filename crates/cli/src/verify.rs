//! `boresight verify`.

use std::process::ExitCode;

use boresight::{CalibrateOptions, Verification, read_calibration};
use serde::Serialize;

use crate::arguments::{AnswerFormat, VerifyArguments};
use crate::failure::{Failure, Reason};
use crate::figures::count;
use crate::inputs;
use crate::streams::{answer, json};
use crate::table::{aligned, row};

/// The schema of what `--format json` prints.
const SCHEMA: &str = "boresight.verification/1";

#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    #[serde(flatten)]
    verification: &'a Verification,
}

/// Judges a calibration on other data and tells whether it is within the limit.
pub(crate) fn run(arguments: &VerifyArguments) -> Result<ExitCode, Failure> {
    let limit = arguments.limit_ratio;
    if !(limit > 0.0 && limit.is_finite()) {
        let message = format!("--limit-ratio {limit}: the limit must be a positive number");
        return Err(Failure::new(Reason::Usage, message).with_hint("such as --limit-ratio 1.5"));
    }
    let (calibration, _) = read_calibration(&arguments.result)?;
    let job = inputs::load(&arguments.input)?;
    let options = CalibrateOptions::of_job(&job)?.adjust_options(&job.dataset);
    let verification = boresight::verify(&calibration, &job.dataset, &options, limit)?;
    match arguments.format {
        AnswerFormat::Json => json(&Document { schema: SCHEMA, verification: &verification })?,
        AnswerFormat::Text => answer(describe(&verification).as_bytes())?,
    }
    Ok(if verification.is_within { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn describe(verification: &Verification) -> String {
    let mut rows = vec![row(["camera", "RMS px", "in the calibration px", "views", "corners"])];
    for camera in &verification.cameras {
        rows.push(vec![
            camera.name.clone(),
            format!("{:.4}", camera.rms_px),
            format!("{:.4}", camera.in_sample_rms_px),
            camera.views.to_string(),
            camera.observations.to_string(),
        ]);
    }
    let mut text = aligned(&rows);
    text.push_str(&format!(
        "{}: {:.4} px per degree of freedom, {:.3} times the calibration's own: {} the limit of {}\n",
        count(verification.frames, "frame"),
        verification.rms_px,
        verification.ratio,
        if verification.is_within { "within" } else { "above" },
        verification.limit_ratio,
    ));
    if let Some(transfer) = &verification.transfer {
        text.push_str(&format!(
            "from one camera's view to another's: {:.4} px, {:.4} mm at the target\n",
            transfer.rms_px, transfer.rms_mm
        ));
    }
    for (n, why) in [
        (verification.rejected, "beyond the limit of an outlier"),
        (verification.left_out, "in views that could not be judged"),
    ] {
        if n > 0 {
            text.push_str(&format!("not counted: {} {why}\n", count(n, "corner")));
        }
    }
    text
}
