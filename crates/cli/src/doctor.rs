//! `boresight doctor`.

use std::path::PathBuf;
use std::process::ExitCode;

use boresight::{CalibrateOptions, Examination, Finding, LensChoice, Severity, examine};
use clap::Args;
use serde::Serialize;

use crate::arguments::InputArguments;
use crate::calibrate::{DETECTIONS_FILE, describe_findings};
use crate::failure::Failure;
use crate::figures::count;
use crate::streams::{answer, json};
use crate::table::{aligned, row};
use crate::{inputs, summary};

/// The schema of what `--json` prints.
const SCHEMA: &str = "boresight.examination/1";

#[derive(Args, Debug)]
pub(crate) struct DoctorArguments {
    #[command(flatten)]
    pub input: InputArguments,
    /// The lens model of the start from which views are judged [default: the job's, or opencv5]
    #[arg(long, value_name = "NAME")]
    pub model: Option<LensChoice>,
    /// The folder in which detections are remembered, for `calibrate` too; made if there are any
    #[arg(short, long, value_name = "DIR", default_value = "out")]
    pub output: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    is_usable: bool,
    cameras: Vec<CameraDocument<'a>>,
    weakest_link: Option<LinkDocument<'a>>,
    findings: &'a [Finding],
}

#[derive(Serialize)]
struct CameraDocument<'a> {
    name: &'a str,
    image_size: [u32; 2],
    views: usize,
    corners: usize,
    coverage: Option<f64>,
    tilt_spread_deg: Option<f64>,
    largest_board: Option<f64>,
    sigma_px: Option<f64>,
}

#[derive(Serialize)]
struct LinkDocument<'a> {
    cameras: Vec<&'a str>,
    frames: usize,
}

/// Tells what is wrong with images, recordings or corners before any solve.
pub(crate) fn run(arguments: &DoctorArguments) -> Result<ExitCode, Failure> {
    let cache = arguments.output.join(DETECTIONS_FILE);
    let job = inputs::load_remembering(&arguments.input, &cache, None)?;
    let stated = CalibrateOptions::of_job(&job)?;
    let options =
        CalibrateOptions { model: arguments.model.clone().unwrap_or(stated.model.clone()), ..stated };
    let found = examine(&job, &options)?;
    if arguments.json {
        json(&document(&found))?;
    } else {
        answer(describe(&found).as_bytes())?;
    }
    Ok(if found.is_usable() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn document(found: &Examination) -> Document<'_> {
    let cameras = found.looks.cameras.iter().zip(&found.dataset.cameras).map(|(look, info)| CameraDocument {
        name: &info.name,
        image_size: info.image_size,
        views: look.views,
        corners: look.corners,
        coverage: look.coverage,
        tilt_spread_deg: look.tilt_spread_rad.map(f64::to_degrees),
        largest_board: look.largest_board,
        sigma_px: look.sigma_px,
    });
    let weakest_link = found.looks.weakest_link.as_ref().map(|link| LinkDocument {
        cameras: link.cameras.iter().map(|id| found.dataset.cameras[*id].name.as_str()).collect(),
        frames: link.frames,
    });
    Document {
        schema: SCHEMA,
        is_usable: found.is_usable(),
        cameras: cameras.collect(),
        weakest_link,
        findings: &found.findings,
    }
}

fn describe(found: &Examination) -> String {
    let shown = |value: Option<f64>, scale: f64, places: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{:.places$}", scale * value))
    };
    let head = ["camera", "image", "views", "corners", "seen %", "tilts deg", "largest board %", "sigma px"];
    let mut rows = vec![row(head)];
    for (look, info) in found.looks.cameras.iter().zip(&found.dataset.cameras) {
        let [width, height] = info.image_size;
        rows.push(row([
            &info.name,
            &format!("{width}x{height}"),
            &look.views.to_string(),
            &look.corners.to_string(),
            &shown(look.coverage, 100.0, 0),
            &shown(look.tilt_spread_rad.map(f64::to_degrees), 1.0, 0),
            &shown(look.largest_board, 100.0, 0),
            &shown(look.sigma_px, 1.0, 3),
        ]));
    }
    let mut text = format!("{}\n{}", summary::of_dataset(&found.dataset), aligned(&rows));
    text.push_str(
        "seen: of the image; tilts: the largest angle between boards; largest board: of the image's diagonal\n",
    );
    if let Some(link) = &found.looks.weakest_link {
        let names: Vec<&str> =
            link.cameras.iter().map(|id| found.dataset.cameras[*id].name.as_str()).collect();
        text.push_str(&format!(
            "weakest link of the rig: {} {} with the others\n",
            names.join(", "),
            if names.len() == 1 {
                format!("shares {}", count(link.frames, "frame"))
            } else {
                format!("share {}", count(link.frames, "frame"))
            }
        ));
    }
    text.push('\n');
    text.push_str(&describe_findings(&found.findings));
    text.push_str(match found.findings.iter().map(|finding| finding.severity).max() {
        None => "nothing is wrong that can be told before a solve\n",
        Some(Severity::Note) => "nothing stands against calibrating this\n",
        Some(Severity::Caution) => "it can be calibrated; the cautions above will show in the result\n",
        Some(Severity::Fail) => "it should not be calibrated as it is\n",
    });
    text
}
