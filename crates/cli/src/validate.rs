//! `boresight validate`.

use std::process::ExitCode;

use boresight::{CalibrateOptions, CompareOptions, RigComparison, Watch, calibrate, cross_validate};
use serde::Serialize;

use crate::arguments::{AnswerFormat, ValidateArguments};
use crate::failure::{Failure, Reason};
use crate::streams::{answer, json};
use crate::{compare, inputs, summary};

/// The schema of what `--format json` prints.
const SCHEMA: &str = "boresight.validation/1";

#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    limit_ratio: f64,
    largest_ratio: f64,
    is_within: bool,
    held_out: Option<&'a boresight::HeldOut>,
    comparison: &'a RigComparison,
}

/// Calibrates odd and even frames apart, and tells whether they differ by more than noise explains.
pub(crate) fn run(arguments: &ValidateArguments) -> Result<ExitCode, Failure> {
    let limit = arguments.limit_ratio;
    if !(limit > 0.0 && limit.is_finite()) {
        let message = format!("--limit-ratio {limit}: the limit must be a positive number");
        return Err(Failure::new(Reason::Usage, message).with_hint("such as --limit-ratio 3"));
    }
    let job = inputs::load(&arguments.input)?;
    let mut options = CalibrateOptions::of_job(&job)?;
    options.model = arguments.model.clone().unwrap_or(options.model);
    let outcome = calibrate(&job, &options, &Watch::default())?;
    let compare_options = CompareOptions { distance_m: arguments.distance_m, ..CompareOptions::default() };
    let comparison =
        cross_validate(&outcome.dataset, &outcome.calibration, &outcome.adjust, &compare_options)?;
    let ratios = comparison.cameras.iter().filter_map(|camera| Some(camera.significance?.ratio));
    let Some(largest) = ratios.reduce(f64::max) else {
        let message = "half of the frames determine too little to tell how well they do";
        return Err(Failure::new(Reason::Input, message).with_hint("add frames"));
    };
    let is_within = largest <= limit;
    let held_out = outcome.calibration.held_out.as_ref();
    match arguments.format {
        AnswerFormat::Json => json(&Document {
            schema: SCHEMA,
            limit_ratio: limit,
            largest_ratio: largest,
            is_within,
            held_out,
            comparison: &comparison,
        })?,
        AnswerFormat::Text => {
            let mut text = compare::describe(&comparison);
            if let Some(held_out) = held_out {
                text.push_str(&format!("unseen  {}\n", summary::unseen(held_out)));
            }
            let word = if is_within { "within" } else { "above" };
            text.push_str(&format!(
                "odd and even frames differ by {largest:.2} times what noise explains: {word} the limit of {limit}\n"
            ));
            answer(text.as_bytes())?;
        }
    }
    Ok(if is_within { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
