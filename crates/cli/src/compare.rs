//! `boresight compare`.

use std::path::Path;
use std::process::ExitCode;

use boresight::{
    Calibration, CompareOptions, ComparedCamera, NamedCamera, RigComparison, compare_known_rigs,
    read_calibration, read_cameras,
};
use serde::Serialize;

use crate::arguments::CompareArguments;
use crate::failure::{Failure, Reason};
use crate::streams::{answer, note};
use crate::table::{aligned, row};

/// The schema of what `--json` prints.
const SCHEMA: &str = "boresight.comparison/1";

/// Compares two calibrations, prints the difference and tells whether it is within the limit.
pub(crate) fn run(arguments: &CompareArguments) -> Result<ExitCode, Failure> {
    if let Some(limit) = arguments.limit_px.filter(|limit| !(*limit >= 0.0 && limit.is_finite())) {
        let message = format!("--limit-px {limit}: the limit must be a number of pixels of at least 0");
        return Err(Failure::new(Reason::Usage, message).with_hint("such as --limit-px 0.5"));
    }
    let (a, b) = (read_any(&arguments.a)?, read_any(&arguments.b)?);
    let (a, b) = made_comparable(a, b);
    let options = CompareOptions { distance_m: arguments.distance_m, ..CompareOptions::default() };
    let [known_a, known_b] = [&arguments.a, &arguments.b].map(|path| native(path));
    let uncertainties =
        [&known_a, &known_b].map(|known| known.as_ref().map(|calibration| &calibration.uncertainty));
    let comparison = compare_known_rigs(&a, &b, uncertainties, &options).map_err(boresight::Error::from)?;
    let limit = arguments.limit_px;
    let largest = comparison.cameras.iter().map(|camera| camera.comparison.rms_px).fold(0.0, f64::max);
    let is_within = limit.is_none_or(|limit| largest <= limit);
    if arguments.json {
        let document = Document {
            schema: SCHEMA,
            largest_rms_px: largest,
            limit_px: limit,
            is_within,
            comparison: &comparison,
        };
        let mut bytes = serde_json::to_vec_pretty(&document).map_err(|error| {
            Failure::new(Reason::CannotWrite, format!("stdout: cannot be written: {error}"))
        })?;
        bytes.push(b'\n');
        answer(&bytes)?;
    } else {
        let mut text = describe(&comparison);
        if let Some(limit) = limit {
            let word = if is_within { "within" } else { "above" };
            text.push_str(&format!(
                "\nlargest RMS difference {largest:.4} px: {word} the limit of {limit} px\n"
            ));
        }
        answer(text.as_bytes())?;
    }
    Ok(if is_within { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    largest_rms_px: f64,
    limit_px: Option<f64>,
    is_within: bool,
    #[serde(flatten)]
    comparison: &'a RigComparison,
}

/// Returns the calibration with its covariance, where the file is one of ours.
fn native(path: &Path) -> Option<Calibration> {
    let is_ours = path.is_dir() || path.extension().is_some_and(|extension| extension == "json");
    // The cameras have been read already, so what is wrong with the file has been said.
    is_ours.then(|| read_calibration(path).ok()).flatten().map(|(calibration, _)| calibration)
}

/// Reads the cameras of a calibration file, of a folder with a `calibration.json`, or of one with `.cameramodel` files.
pub(crate) fn read_any(path: &Path) -> Result<Vec<NamedCamera>, Failure> {
    if !path.is_dir() {
        return Ok(read_cameras(path)?);
    }
    let native = path.join("calibration.json");
    if native.is_file() {
        return Ok(read_cameras(&native)?);
    }
    let unreadable = |error: std::io::Error| {
        Failure::new(Reason::Input, format!("{}: cannot be read: {error}", path.display()))
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(unreadable)? {
        let file = entry.map_err(unreadable)?.path();
        if file.extension().is_some_and(|extension| extension == "cameramodel") {
            files.push(file);
        }
    }
    files.sort();
    if files.is_empty() {
        let message = format!("{}: the folder has no calibration.json and no .cameramodel", path.display());
        return Err(Failure::new(Reason::Input, message)
            .with_hint("name a file, such as calibration.json or stereo.yml"));
    }
    let mut cameras = Vec::new();
    for file in files {
        cameras.extend(read_cameras(&file)?);
    }
    Ok(cameras)
}

/// Returns the cameras ready to be paired: by name, or by order where no name is common; where one
/// file does not tell the size of the images, the other's holds.
fn made_comparable(a: Vec<NamedCamera>, b: Vec<NamedCamera>) -> (Vec<ComparedCamera>, Vec<ComparedCamera>) {
    let compared = |cameras: Vec<NamedCamera>| -> Vec<ComparedCamera> {
        let pick =
            |NamedCamera { name, camera, cam_from_rig, .. }| ComparedCamera { name, camera, cam_from_rig };
        cameras.into_iter().map(pick).collect()
    };
    let (mut a, mut b) = (compared(a), compared(b));
    let has_common = a.iter().any(|in_a| b.iter().any(|in_b| in_a.name == in_b.name));
    if !has_common && a.len() == b.len() && a.len() > 1 {
        let pairs: Vec<String> =
            a.iter().zip(&b).map(|(in_a, in_b)| format!("{} with {}", in_a.name, in_b.name)).collect();
        note(&format!("note: no camera has the same name in both; compared by order: {}", pairs.join(", ")));
        b.iter_mut().zip(&a).for_each(|(in_b, in_a)| in_b.name = in_a.name.clone());
    }
    // A file of one camera often bears its name at the end: mrcal-left.cameramodel.
    if !has_common
        && a.len() > 1
        && let [single] = &mut b[..]
    {
        let mut ending = a.iter().filter(|in_a| single.name.ends_with(&in_a.name));
        if let (Some(in_a), None) = (ending.next(), ending.next()) {
            note(&format!("note: {} is compared with {}, by the end of its name", in_a.name, single.name));
            single.name = in_a.name.clone();
        }
    }
    let is_single = a.len() == 1 && b.len() == 1;
    for in_a in &mut a {
        for in_b in b.iter_mut().filter(|in_b| is_single || in_b.name == in_a.name) {
            let (of_a, of_b) = (&mut in_a.camera.image_size, &mut in_b.camera.image_size);
            match (*of_a, *of_b) {
                ([0, 0], known) => *of_a = known,
                (known, [0, 0]) => *of_b = known,
                _ => {}
            }
        }
    }
    (a, b)
}

pub(crate) fn describe(comparison: &RigComparison) -> String {
    let mut rows = vec![row([
        "camera", "RMS px", "p95 px", "max px", "noise px", "times", "rx deg", "ry deg", "rz deg", "x mm",
        "y mm", "z mm",
    ])];
    for camera in &comparison.cameras {
        let difference = &camera.comparison;
        let mut cells = vec![if camera.name == camera.name_in_b {
            camera.name.clone()
        } else {
            format!("{} / {}", camera.name, camera.name_in_b)
        }];
        cells.extend([difference.rms_px, difference.p95_px, difference.max_px].map(|px| format!("{px:.4}")));
        cells.extend(match camera.significance {
            Some(found) => [format!("{:.4}", found.predicted_rms_px), format!("{:.2}", found.ratio)],
            None => ["-"; 2].map(str::to_owned),
        });
        cells.extend(difference.rotation_rad.map(|radians| format!("{:.4}", radians.to_degrees() + 0.0)));
        cells.extend(match difference.distance_m {
            Some(_) => difference.translation_m.map(|metres| format!("{:.3}", 1e3 * metres)),
            None => ["-"; 3].map(str::to_owned),
        });
        rows.push(cells);
    }
    let distance = comparison.cameras.first().and_then(|camera| camera.comparison.distance_m);
    let place = distance.map_or_else(|| "at infinity".to_owned(), |distance| format!("at {distance} m"));
    let mut text = aligned(&rows);
    text.push_str(&format!(
        "difference of the pixels that see the same point {place}, over the image, after the implied transform\n\
         (rotation r, translation x y z) of the camera frame;\n\
         noise: what both covariances predict of RMS; times: how many times that the difference is\n"
    ));
    if !comparison.pairs.is_empty() {
        let head = [
            "pair",
            "baseline a mm",
            "baseline b mm",
            "rotation deg",
            "position mm",
            "aligned deg",
            "aligned mm",
            "times",
            "transfer px",
            "times",
            "transfer mm",
        ];
        let mut rows = vec![row(head)];
        for pair in &comparison.pairs {
            rows.push(row([
                &format!("{} to {}", pair.from, pair.to),
                &format!("{:.3}", pair.baseline_a_mm),
                &format!("{:.3}", pair.baseline_b_mm),
                &format!("{:.4}", pair.rotation_deg),
                &format!("{:.3}", pair.translation_mm),
                &format!("{:.4}", pair.aligned_rotation_deg),
                &format!("{:.3}", pair.aligned_translation_mm),
                &pair.significance.map_or_else(dash, |found| format!("{:.2}", found.ratio)),
                &pair.transfer.map_or_else(dash, |transfer| format!("{:.4}", transfer.rms_px)),
                &pair
                    .transfer
                    .and_then(|transfer| transfer.significance)
                    .map_or_else(dash, |found| format!("{:.2}", found.ratio)),
                &pair
                    .transfer
                    .and_then(|transfer| transfer.rms_mm)
                    .map_or_else(dash, |mm| format!("{mm:.3}")),
            ]));
        }
        text.push('\n');
        text.push_str(&aligned(&rows));
        text.push_str("aligned: what is left after the implied transforms of both cameras;\n\
                       transfer: where the second camera sees what the first sees; times: in units of the noise\n");
    }
    for (names, which) in [(&comparison.only_in_a, "first"), (&comparison.only_in_b, "second")] {
        if !names.is_empty() {
            text.push_str(&format!("only in the {which}: {}\n", names.join(", ")));
        }
    }
    text
}

fn dash() -> String {
    "-".to_owned()
}
