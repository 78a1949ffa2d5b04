//! `boresight convert`.

use std::process::ExitCode;

use boresight::{
    ConvertedCamera, ImpliedRotation, OutputFile, calibration_to_json, convert_lenses, read_calibration,
    write_files,
};
use serde::Serialize;

use crate::arguments::{ConvertArguments, Rotation};
use crate::failure::{Failure, Reason};
use crate::streams::{answer, note};
use crate::table::{aligned, row};

/// The schema of what `--json` prints.
const SCHEMA: &str = "boresight.conversion/1";

/// Exchanges the lens model of each camera, prints what that costs and tells whether it is within the limit.
pub(crate) fn run(arguments: &ConvertArguments) -> Result<ExitCode, Failure> {
    if let Some(limit) = arguments.limit_px.filter(|limit| !(*limit >= 0.0 && limit.is_finite())) {
        let message = format!("--limit-px {limit}: the limit must be a number of pixels of at least 0");
        return Err(Failure::new(Reason::Usage, message).with_hint("such as --limit-px 0.5"));
    }
    let (calibration, findings) = read_calibration(&arguments.result)?;
    let rotation = match arguments.rotation {
        Rotation::Fit => ImpliedRotation::Fitted,
        Rotation::Keep => ImpliedRotation::None,
    };
    let (changed, cameras) = convert_lenses(&calibration, arguments.model, rotation)?;
    if let Some(folder) = &arguments.output {
        let bytes = calibration_to_json(&changed, &findings)?;
        write_files(folder, &[OutputFile { name: "calibration.json".to_owned(), bytes }])?;
        note(&format!("wrote {}", folder.join("calibration.json").display()));
    }
    let largest = cameras.iter().map(|camera| camera.converted.max_px).fold(0.0, f64::max);
    let is_within = arguments.limit_px.is_none_or(|limit| largest <= limit);
    if arguments.json {
        let cameras = cameras.iter().map(CameraDocument::new).collect();
        let document = Document {
            schema: SCHEMA,
            largest_px: largest,
            limit_px: arguments.limit_px,
            is_within,
            cameras,
        };
        let mut bytes = serde_json::to_vec_pretty(&document).map_err(|error| {
            Failure::new(Reason::CannotWrite, format!("stdout: cannot be written: {error}"))
        })?;
        bytes.push(b'\n');
        answer(&bytes)?;
    } else {
        answer(describe(&cameras).as_bytes())?;
        if let (Some(limit), false) = (arguments.limit_px, is_within) {
            note(&format!("the largest error, {largest:.4} px, is above the limit of {limit} px"));
        }
    }
    Ok(if is_within { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

#[derive(Serialize)]
struct Document {
    schema: &'static str,
    largest_px: f64,
    limit_px: Option<f64>,
    is_within: bool,
    cameras: Vec<CameraDocument>,
}

#[derive(Serialize)]
struct CameraDocument {
    name: String,
    from: String,
    to: String,
    rms_px: f64,
    max_px: f64,
    rotation_rad: f64,
    share_of_image: f64,
}

impl CameraDocument {
    fn new(ConvertedCamera { name, from, converted }: &ConvertedCamera) -> Self {
        Self {
            name: name.clone(),
            from: from.to_string(),
            to: converted.camera.model.to_string(),
            rms_px: converted.rms_px,
            max_px: converted.max_px,
            rotation_rad: converted.new_from_old.rotation.angle(),
            share_of_image: converted.share,
        }
    }
}

fn describe(cameras: &[ConvertedCamera]) -> String {
    let mut rows = vec![row(["camera", "from", "to", "RMS px", "max px", "turned deg", "of the image %"])];
    for camera in cameras {
        let CameraDocument { name, from, to, rms_px, max_px, rotation_rad, share_of_image } =
            CameraDocument::new(camera);
        rows.push(vec![
            name,
            from,
            to,
            format!("{rms_px:.4}"),
            format!("{max_px:.4}"),
            format!("{:.4}", rotation_rad.to_degrees()),
            format!("{:.1}", 100.0 * share_of_image),
        ]);
    }
    aligned(&rows)
}
