//! `cargo xtask datasets --recorded`: calibrates the recorded sets beside the project, and has OpenCV and mrcal do so too.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use serde::Deserialize;
use serde_json::json;

use super::DOCS;
use super::recorded_sets::{ForMrcal, RecordedSets, Set};
use crate::process::{boresight, command, output, reference_environment, root, target};
use crate::table::{self, markdown};

const COMMAND: &str = "cargo xtask datasets --recorded";
const DATASETS: &str = "../shared/datasets";

#[derive(Debug, Deserialize)]
struct Answers {
    ours: Ours,
    opencv: Option<OpenCv>,
}

#[derive(Debug, Deserialize)]
struct Ours {
    code: i32,
    seconds: f64,
    why: Option<String>,
    #[serde(default)]
    views: usize,
    #[serde(default)]
    corners: usize,
    #[serde(default)]
    rejected: usize,
    #[serde(default)]
    uncalibrated: Vec<String>,
    rms: Option<f64>,
    held_out: Option<f64>,
    focal_px: Option<f64>,
    #[serde(default)]
    findings: Vec<[String; 2]>,
}

#[derive(Debug, Deserialize)]
struct OpenCv {
    version: String,
    images: usize,
    views: usize,
    corners: usize,
    cameras: usize,
    rms: Option<f64>,
    joint_rms: Option<f64>,
    held_out: Option<f64>,
    seconds: Option<f64>,
    why: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Mrcal {
    version: String,
    corners: usize,
    rejected: usize,
    rms: f64,
    seconds: f64,
}

/// Calibrates the sets whose name contains one of `named`, or all. Exit codes: 0 good, 1 a set failed without saying why.
///
/// `program` is ours; without it the release build is made and taken.
pub(super) fn run(named: &[String], program: Option<PathBuf>, keep_docs: bool) -> anyhow::Result<ExitCode> {
    let sets = RecordedSets::read()?;
    let is_known = |name: &&String| sets.set.iter().any(|set| set.name.contains(name.as_str()));
    if let Some(unknown) = named.iter().find(|name| !is_known(name)) {
        let known: Vec<&str> = sets.set.iter().map(|set| set.name.as_str()).collect();
        bail!("no recorded set has {unknown} in its name; there are {}", known.join("; "));
    }
    let folder = root().join(DATASETS);
    if !folder.is_dir() {
        bail!("{} is not there", folder.display());
    }
    let program = match program {
        Some(program) => std::path::absolute(&program).with_context(|| program.display().to_string())?,
        None => boresight()?,
    };
    let (mut rows, mut of_mrcal, mut failed) = (Vec::new(), Vec::new(), Vec::new());
    let mut versions = ["?".to_owned(), "?".to_owned()];
    let is_named = |set: &&Set| named.is_empty() || named.iter().any(|name| set.name.contains(name.as_str()));
    for set in sets.set.iter().filter(is_named) {
        eprintln!("{}", set.name);
        let folder = folder.join(&set.folder);
        let answers = calibrate(&program, set, &folder)?;
        if let Some(opencv) = &answers.opencv {
            versions[0].clone_from(&opencv.version);
        }
        if !matches!(answers.ours.code, 0 | 1) && answers.ours.why.is_none() {
            failed.push(set.name.as_str());
        }
        rows.push(row(set, &answers));
        if let (Some(for_mrcal), Some(focal_px)) = (&set.mrcal, answers.ours.focal_px) {
            let corners = folder.join(&for_mrcal.corners);
            let (mrcal, ours) = beside_mrcal(&program, set, &corners, &for_mrcal.lens, focal_px)?;
            versions[1].clone_from(&mrcal.version);
            of_mrcal.push(mrcal_row(set, for_mrcal, &mrcal, &ours));
        }
    }
    let head = [
        "set",
        "images",
        "used",
        "corners",
        "RMS px",
        "left-out px",
        "CPU s",
        "OpenCV: used",
        "corners",
        "RMS px",
        "left-out px",
        "CPU s",
        "verdict and findings",
    ];
    let mrcal_head = [
        "set, lens",
        "corners kept: ours / mrcal",
        "rejected: ours / mrcal",
        "RMS px: ours / mrcal",
        "CPU s: ours / mrcal",
    ];
    let others: Vec<Vec<String>> =
        sets.other.iter().map(|other| vec![other.name.clone(), other.why.clone()]).collect();
    let text = format!(
        "OpenCV {}; for pairs the RMS of stereoCalibrate, for more cameras (marked *) that of each alone.\n\n{}\n\
         The same corners, ours and mrcal {}, rejection on:\n\n{}\n{}",
        versions[0],
        markdown(&head, &rows),
        versions[1],
        markdown(&mrcal_head, &of_mrcal),
        markdown(&["not for `calibrate`", "why"], &others),
    );
    println!("{text}");
    if keep_docs || !named.is_empty() {
        eprintln!("datasets: {DOCS} is left as it is");
    } else {
        table::rewrite(DOCS, COMMAND, &text)?;
    }
    if !failed.is_empty() {
        eprintln!("no reason was told by: {}", failed.join(", "));
        return Ok(ExitCode::from(1));
    }
    Ok(ExitCode::SUCCESS)
}

fn out(name: &str) -> anyhow::Result<PathBuf> {
    let name: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect();
    let out = target().join("datasets-recorded").join(name);
    std::fs::create_dir_all(&out).with_context(|| out.display().to_string())?;
    Ok(out)
}

fn arguments(set: &Set, inputs: &[PathBuf], target: &str) -> Vec<String> {
    let mut arguments: Vec<String> = inputs.iter().map(|input| input.display().to_string()).collect();
    arguments.extend(["--target", target].map(str::to_owned));
    let is_corners = inputs.iter().any(|input| input.extension().is_some_and(|extension| extension == "vnl"));
    if let Some([width, height]) = set.image_size.filter(|_| is_corners) {
        arguments.extend(["--image-size".to_owned(), format!("{width}x{height}")]);
        // A .vnl does not say which camera an image is of; the names tell.
        for camera in &set.cameras {
            arguments.extend(["--camera", camera].map(str::to_owned));
        }
    }
    arguments
}

/// Runs ours and OpenCV.
fn calibrate(program: &Path, set: &Set, folder: &Path) -> anyhow::Result<Answers> {
    let inputs: Vec<PathBuf> = set.inputs.iter().map(|input| folder.join(input)).collect();
    let corners = set.images.is_empty().then(|| set.inputs.first().map(|input| folder.join(input))).flatten();
    let job = json!({
        "program": program,
        "arguments": arguments(set, &inputs, &set.target),
        "out": out(&set.name)?,
        "folder": folder,
        "kind": set.kind(),
        "size": set.size()?,
        "images": set.images,
        "corners": corners,
        "image_size": set.image_size,
        "name": set.pattern,
    });
    let mut python = command(reference_environment().join("bin/python"));
    answer(&output(python.arg("tools/bench/recorded_set.py").arg(job.to_string()))?)
}

/// Runs mrcal and ours on the same corners.
fn beside_mrcal(
    program: &Path,
    set: &Set,
    corners: &Path,
    lens: &str,
    focal_px: f64,
) -> anyhow::Result<(Mrcal, Ours)> {
    let ([columns, rows], spacing_mm) = (set.size()?, set.spacing_mm()?);
    let job = json!({
        "corners": corners,
        "size": [columns, rows],
        "image_size": set.image_size,
        "focal_px": focal_px,
        "name": set.pattern,
        "lens": format!("LENSMODEL_{}", lens.to_uppercase()),
        "spacing_m": 1e-3 * spacing_mm,
    });
    let mrcal =
        output(command("/usr/bin/python3").arg("tools/bench/recorded_mrcal.py").arg(job.to_string()))?;
    let target = format!("chessboard:{columns}x{rows}:{spacing_mm}mm");
    let mut arguments = arguments(set, &[corners.to_owned()], &target);
    arguments.extend(["--model", lens, "--holdout", "off"].map(str::to_owned));
    let job =
        json!({ "program": program, "arguments": arguments, "out": out(&format!("{} mrcal", set.name))? });
    let mut python = command(reference_environment().join("bin/python"));
    let ours: Answers = answer(&output(python.arg("tools/bench/recorded_set.py").arg(job.to_string()))?)?;
    Ok((answer(&mrcal)?, ours.ours))
}

fn answer<T: serde::de::DeserializeOwned>(text: &str) -> anyhow::Result<T> {
    let line = text.lines().rfind(|line| line.starts_with('{')).context("no line of JSON was printed")?;
    serde_json::from_str(line).with_context(|| line.to_owned())
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

fn row(set: &Set, answers: &Answers) -> Vec<String> {
    let Answers { ours, opencv } = answers;
    let images = opencv.as_ref().map_or("1".to_owned(), |opencv| opencv.images.to_string());
    let mut row = vec![set.name.clone(), images];
    row.extend([
        ours.views.to_string(),
        ours.corners.to_string(),
        number(ours.rms, 4),
        number(ours.held_out, 4),
        format!("{:.2}", ours.seconds),
    ]);
    match opencv {
        None => row.extend(["-"; 5].map(str::to_owned)),
        Some(opencv) => {
            let mark = if opencv.cameras > 2 { "*" } else { "" };
            row.extend([
                opencv.views.to_string(),
                opencv.corners.to_string(),
                format!("{}{mark}", number(opencv.joint_rms.or(opencv.rms), 4)),
                number(opencv.held_out, 4),
                number(opencv.seconds, 2),
            ]);
        }
    }
    let mut words = vec![match (ours.code, &ours.why) {
        (_, Some(why)) => why.clone(),
        (0, None) => "good or caution".to_owned(),
        (1, None) => "fail".to_owned(),
        (code, None) => format!("exit {code}"),
    }];
    if !ours.uncalibrated.is_empty() {
        words.push(format!("without {}", ours.uncalibrated.join(", ")));
    }
    let mut codes: Vec<String> = ours
        .findings
        .iter()
        .filter(|[_, severity]| severity != "note")
        .map(|[code, severity]| if severity == "fail" { format!("{code} (fail)") } else { code.clone() })
        .collect();
    codes.dedup();
    words.extend(codes);
    if let Some(why) = opencv.as_ref().and_then(|opencv| opencv.why.as_ref()) {
        words.push(format!("OpenCV: {why}"));
    }
    row.push(words.join(", ").replace('|', "/"));
    row
}

fn mrcal_row(set: &Set, for_mrcal: &ForMrcal, mrcal: &Mrcal, ours: &Ours) -> Vec<String> {
    vec![
        format!("{}, {}", set.name, for_mrcal.lens),
        format!("{} / {}", ours.corners, mrcal.corners),
        format!("{} / {}", ours.rejected, mrcal.rejected),
        format!("{} / {:.4}", number(ours.rms, 4), mrcal.rms),
        format!("{:.2} / {:.2}", ours.seconds, mrcal.seconds),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_that_is_refused_says_why() {
        let text = r#"noise
            {"ours": {"code": 3, "seconds": 0.5, "why": "error: a | b"}, "opencv": null}"#
            .replace("            {", "{");
        let answers: Answers = answer(&text).unwrap();
        let row = row(&RecordedSets::read().unwrap().set[0], &answers);
        assert_eq!(row.len(), 13);
        assert_eq!(row[12], "error: a / b");
        assert_eq!(row[4], "-");
    }

    #[test]
    fn sets_are_named_once_and_say_all() {
        let sets = RecordedSets::read().unwrap().set;
        for (i, set) in sets.iter().enumerate() {
            assert!(sets[..i].iter().all(|other| other.name != set.name), "{}", set.name);
            assert!(!set.inputs.is_empty() && set.pattern.contains("(?P<frame>"), "{}", set.name);
            let [columns, rows] = set.size().unwrap();
            assert!(columns > 2 && rows > 2 && set.spacing_mm().unwrap() > 1.0, "{}", set.name);
        }
    }
}
