//! `boresight info`.

use std::path::Path;
use std::process::ExitCode;

use boresight::{
    CalibrateOptions, Dataset, Id as _, Job, NamedCamera, StatedCamera, Survey, read_calibration,
    read_cameras, survey_recordings, verdict,
};

use crate::arguments::InfoArguments;
use crate::calibrate::tell_findings;
use crate::failure::Failure;
use crate::figures::significant;
use crate::inputs::{self, InputKind};
use crate::streams::answer;
use crate::summary;
use crate::table::{aligned, row};

/// Prints what is in a dataset or a calibration.
pub(crate) fn run(arguments: &InfoArguments) -> Result<ExitCode, Failure> {
    let text = match &arguments.input.inputs[..] {
        [path] if is_calibration(path) || is_cameras(path) => {
            inputs::refuse_idle_flags(&arguments.input, InputKind::Calibrations)?;
            if is_calibration(path) { of_calibration(path)? } else { of_cameras(&read_cameras(path)?) }
        }
        recordings if is_survey(arguments) => {
            inputs::refuse_idle_flags(&arguments.input, InputKind::Recordings)?;
            let overrides = inputs::overrides(&arguments.input);
            let survey = survey_recordings(recordings, &overrides.recording, &overrides.cameras)?;
            tell_findings(&survey.findings);
            of_recordings(&survey)
        }
        _ => {
            let job = inputs::load(&arguments.input)?;
            tell_findings(&job.findings);
            of_job(&job)?
        }
    };
    answer(text.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

/// Tells whether recordings are named and no target to be detected in them.
fn is_survey(arguments: &InfoArguments) -> bool {
    let input = &arguments.input;
    let are_recordings = !input.inputs.is_empty() && input.inputs.iter().all(|path| is_recording(path));
    are_recordings && input.target.is_none() && input.config.is_none()
}

fn is_calibration(path: &Path) -> bool {
    if path.is_dir() {
        path.join("calibration.json").is_file() && !path.join("boresight.toml").is_file()
    } else {
        has_extension(path, &["json"])
    }
}

fn is_cameras(path: &Path) -> bool {
    has_extension(path, &["cameramodel", "yml", "yaml"])
}

fn is_recording(path: &Path) -> bool {
    has_extension(path, &["mcap"]) && !path.is_dir()
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .is_some_and(|found| extensions.iter().any(|extension| found.eq_ignore_ascii_case(extension)))
}

fn of_calibration(path: &Path) -> Result<String, Failure> {
    let (calibration, findings) = read_calibration(path)?;
    tell_findings(&findings);
    let made = &calibration.provenance;
    let mut rows = vec![vec![format!("calibration by Boresight {}", made.version)]];
    rows.extend(
        made.inputs
            .iter()
            .map(|(name, hash)| vec![format!("from {name}, blake3 {}", &hash[..hash.len().min(16)])]),
    );
    let options: Vec<String> = made.options.iter().map(|(name, value)| format!("{name} {value}")).collect();
    rows.push(vec![format!("options: {}", options.join(", "))]);
    let verdict = summary::verdict_line(verdict(&findings), &findings);
    Ok(format!("{}\n{}\n{verdict}\n", aligned(&rows), summary::of_calibration(&calibration)))
}

fn of_cameras(cameras: &[NamedCamera]) -> String {
    let mut text = String::new();
    for NamedCamera { name, camera, cam_from_rig, .. } in cameras {
        let [width, height] = camera.image_size;
        let size = if width > 0 { format!("{width}x{height}") } else { "size unknown".to_owned() };
        let mut rows = vec![row([&format!("camera {name}"), &format!("{}, {size}", camera.model)])];
        let params = camera.model.param_names().into_iter().zip(&camera.params);
        rows.extend(params.map(|(param, value)| row([param, &significant(*value)])));
        if let Some(cam_from_rig) = cam_from_rig {
            let [x, y, z]: [f64; 3] = cam_from_rig.inverse().translation.into();
            let at = [x, y, z].map(|metres| significant(1e3 * metres)).join(", ");
            rows.push(row(["position mm", &at]));
        }
        text.push_str(&aligned(&rows));
        text.push('\n');
    }
    text
}

fn of_recordings(survey: &Survey) -> String {
    let seconds = |time_ns: i64| time_ns as f64 / 1e9;
    let mut rows = vec![row(["topic", "schema", "encoding", "messages"])];
    for topic in &survey.topics {
        rows.push(row([&topic.name, &topic.schema, &topic.encoding, &topic.messages.to_string()]));
    }
    let mut text = aligned(&rows);
    let mut rows = vec![row(["camera", "topic", "images", "size", "pixels", "s", "images/s", "said of it"])];
    for image in &survey.images {
        let sizes: Vec<String> =
            image.sizes.iter().map(|[width, height]| format!("{width}x{height}")).collect();
        let span = image.span_ns.map(|[first, last]| seconds(last.saturating_sub(first)));
        let or_dash =
            |text: Option<String>| text.filter(|text| !text.is_empty()).unwrap_or_else(|| "-".to_owned());
        rows.push(row([
            &image.camera,
            &image.topic,
            &image.messages.to_string(),
            &or_dash(Some(sizes.join(" "))),
            &or_dash(Some(image.encodings.join(" "))),
            &or_dash(span.map(|span| format!("{span:.2}"))),
            &or_dash(image.period_ns.map(|period| format!("{:.2}", 1.0 / seconds(period)))),
            &or_dash(image.camera_info.as_ref().map(camera_info_in_words)),
        ]));
    }
    if !survey.images.is_empty() {
        text.push('\n');
        text.push_str(&aligned(&rows));
    }
    for pair in &survey.pairs {
        let [first, second] = &pair.cameras;
        text.push_str(&format!(
            "\n{}: {} of {} images within {:.2} ms; time of {second} less {first}, in ms:\n",
            pair.describe(),
            pair.within,
            pair.pairs,
            survey.tolerance_ns as f64 / 1e6,
        ));
        let [from, to] = pair.histogram_range_ns.map(|time| time as f64 / 1e6);
        let width = (to - from) / pair.histogram.len() as f64;
        let most = pair.histogram.iter().copied().max().unwrap_or(0).max(1);
        let mut bars = Vec::new();
        for (i, count) in pair.histogram.iter().enumerate() {
            let begin = from + i as f64 * width;
            let bar = "#".repeat((count * 40).div_ceil(most));
            bars.push(
                format!("{begin:10.3} to {:10.3} {count:6} {bar}", begin + width).trim_end().to_owned(),
            );
        }
        text.push_str(&bars.join("\n"));
        text.push('\n');
    }
    text
}

fn camera_info_in_words(info: &StatedCamera) -> String {
    let [width, height] = info.image_size;
    let [fx, fy, cx, cy] = info.intrinsics.map(significant);
    if info.intrinsics[0] == 0.0 {
        return format!("{width}x{height}, not calibrated");
    }
    format!("{width}x{height} {} fx {fx} fy {fy} cx {cx} cy {cy}", info.distortion_model)
}

fn of_job(job: &Job) -> Result<String, Failure> {
    let Dataset { cameras, views, .. } = &job.dataset;
    let mut rows = vec![row(["camera", "image", "views", "corners", "u px", "v px"])];
    for (id, camera) in cameras.enumerate() {
        let of_camera = || views.iter().filter(|view| view.camera.index() == id.index());
        let observations = || of_camera().flat_map(|view| &view.observations);
        let range = |axis: usize| {
            let pixels = observations().map(|observation| observation.pixel[axis]);
            let (least, most) =
                pixels.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), pixel| (a.min(pixel), b.max(pixel)));
            if least <= most { format!("{least:.0} to {most:.0}") } else { "-".to_owned() }
        };
        let [width, height] = camera.image_size;
        rows.push(row([
            &camera.name,
            &format!("{width}x{height}"),
            &of_camera().count().to_string(),
            &observations().count().to_string(),
            &range(0),
            &range(1),
        ]));
    }
    let options = CalibrateOptions::of_job(job)?;
    let stated: Vec<String> =
        options.stated().iter().map(|(name, value)| format!("{name} {value}")).collect();
    let inputs: Vec<&str> = job.inputs.iter().map(|(name, _)| name.as_str()).collect();
    Ok(format!(
        "{}files {}\n\n{}\noptions: {}\n",
        summary::of_dataset(&job.dataset),
        inputs.join(", "),
        aligned(&rows),
        stated.join(", ")
    ))
}
