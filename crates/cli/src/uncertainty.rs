//! `boresight uncertainty`.

use std::process::ExitCode;

use boresight::{
    AtDistance, Method, Propagation, UncertaintyMap, UncertaintyOptions, UncertaintyReport, read_calibration,
};
use serde::Serialize;

use crate::arguments::{AnswerFormat, UncertaintyArguments, UncertaintyMethod};
use crate::failure::Failure;
use crate::streams::{answer, json};
use crate::table::{aligned, row};

/// The schema of what `--format json` prints.
const SCHEMA: &str = "boresight.uncertainty/1";

#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    #[serde(flatten)]
    report: &'a UncertaintyReport,
}

/// Prints how well a calibration's projections and distances are known.
pub(crate) fn run(arguments: &UncertaintyArguments) -> Result<ExitCode, Failure> {
    let (calibration, _) = read_calibration(&arguments.result)?;
    let defaults = UncertaintyOptions::default();
    let distances = &arguments.distance_m;
    let options = UncertaintyOptions {
        cameras: arguments.camera.clone(),
        distances_m: if distances.is_empty() {
            defaults.distances_m.clone()
        } else {
            distances.iter().map(|&distance| (distance != f64::INFINITY).then_some(distance)).collect()
        },
        grid: arguments.grid.0,
        method: match arguments.method {
            UncertaintyMethod::CrossReprojection => Method::CrossReprojection,
            UncertaintyMethod::MeanFrame => Method::MeanFrame,
        },
        propagation: if arguments.observations_only {
            Propagation::ObservationsOnly
        } else {
            Propagation::WithBeliefs
        },
    };
    let report = boresight::uncertainty(&calibration, &options)?;
    match arguments.format {
        AnswerFormat::Json => json(&Document { schema: SCHEMA, report: &report })?,
        AnswerFormat::Text => answer(describe(&report).as_bytes())?,
    }
    Ok(ExitCode::SUCCESS)
}

fn describe(report: &UncertaintyReport) -> String {
    let head = ["camera", "distance m", "middle px", "middle mm", "median px", "p95 px", "largest px"];
    let mut rows = vec![row(head)];
    for camera in &report.cameras {
        for map in &camera.maps {
            let is_same = |at: &&AtDistance| at.distance_m == map.distance_m;
            let middle = camera.middle.iter().find(is_same);
            let quantile = |share: f64| map.quantile_px(share).map_or_else(dash, px);
            rows.push(vec![
                camera.name.clone(),
                distance(map),
                middle.map_or_else(dash, |at| px(at.worst_px)),
                middle.and_then(|at| at.worst_mm).map_or_else(dash, significant3),
                quantile(0.5),
                quantile(0.95),
                quantile(1.0),
            ]);
        }
    }
    let mut text = aligned(&rows);
    text.push_str(
        "one standard deviation of where a point at that distance appears, along the worst direction, over the image\n",
    );
    if !report.pairs.is_empty() {
        let head = [
            "pair",
            "baseline mm",
            "sigma mm",
            "distance m",
            "calibration mm",
            "largest mm",
            "one corner mm",
        ];
        let mut rows = vec![row(head)];
        for pair in &report.pairs {
            rows.push(vec![
                format!("{} to {}", pair.from, pair.to),
                format!("{:.3}", pair.baseline_mm),
                significant3(pair.baseline_sigma_mm),
                pair.distance_m.to_string(),
                significant3(pair.calibration_sigma_mm),
                significant3(pair.calibration_worst_mm),
                significant3(pair.observation_sigma_mm),
            ]);
        }
        text.push('\n');
        text.push_str(&aligned(&rows));
        text.push_str(
            "one standard deviation of the distance that two cameras measure: from the calibration (median and \
             largest over\nwhat both see), and from the noise of one corner in each image\n",
        );
    }
    text
}

fn distance(map: &UncertaintyMap) -> String {
    map.distance_m.map_or_else(|| "inf".to_owned(), |distance| format!("{distance}"))
}

fn px(value: f64) -> String {
    format!("{value:.4}")
}

/// Returns a value to three digits.
fn significant3(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let leading = value.abs().log10().floor();
    format!("{value:.*}", (2.0 - leading).clamp(0.0, 9.0) as usize)
}

fn dash() -> String {
    "-".to_owned()
}
