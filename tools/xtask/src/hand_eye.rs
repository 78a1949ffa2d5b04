//! `cargo xtask hand-eye`: calibrates the recorded robots and writes the tables of `docs/hand-eye.md`.

mod planar;
mod poses;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use serde::Deserialize;

use crate::arguments::Arguments;
use crate::process::{boresight, command, output, root, run as run_process, shown, target};
use crate::table::{self, markdown};

const DOCS: &str = "docs/hand-eye.md";
const COMMAND: &str = "cargo xtask hand-eye";
/// The jobs; their recordings lie beside the project.
const JOBS: &str = "tests/recorded";
const SHARED: &str = "../shared/datasets";
const TAG_CORNERS: &str = "target/robot/franka-to-hand.csv";

/// What the tables show of a `hand-eye.json`.
#[derive(Debug, Deserialize)]
struct HandEye {
    leave_one_out: Method,
    methods: Vec<Method>,
    robot_noise: Option<Noise>,
    median_sigma_m: Option<f64>,
    findings: Vec<Finding>,
}

#[derive(Debug, Deserialize)]
struct Method {
    name: String,
    figures: Option<Figures>,
}

#[derive(Debug, Deserialize)]
struct Figures {
    mean_m: f64,
    p95_m: f64,
    max_m: f64,
}

#[derive(Debug, Deserialize)]
struct Noise {
    rotation_rad: f64,
    translation_m: f64,
}

#[derive(Debug, Deserialize)]
struct Finding {
    code: String,
}

/// OpenCV's figures: of each recording those of each method, mean, 95 % and largest, in mm.
type Reference = BTreeMap<String, BTreeMap<String, [f64; 3]>>;

/// Calibrates all recorded robots. `BORESIGHT_OPENCV4_PYTHON` is a Python whose OpenCV has calibrateHandEye; with
/// `--keep-reference` OpenCV's figures stay as they are in the documentation.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let keep_docs = arguments.flag("--keep-docs");
    let keep_reference = arguments.flag("--keep-reference");
    if !arguments.rest()?.is_empty() {
        bail!("there is nothing to name: all recorded robots are calibrated");
    }
    if !root().join(TAG_CORNERS).is_file() {
        let images = Path::new(SHARED).join("handeye-franka-visp/raw/eye-to-hand");
        let tags = crate::process::reference_environment().join("bin/python");
        let mut detect = command(tags);
        run_process(detect.arg("tools/reference/tag_corners.py").arg(images).args(["36h11", TAG_CORNERS]))?;
    }
    let reference = if keep_reference { kept_reference()? } else { made_reference()? };
    let program = boresight()?;
    let (mut headlines, mut methods) = (Vec::new(), Vec::new());
    for name in jobs()? {
        let found = calibrate(&program, &name)?;
        let of_opencv = reference.get(&name).cloned().unwrap_or_default();
        let best = of_opencv.iter().min_by(|one, other| one.1[0].total_cmp(&other.1[0]));
        let own = found.leave_one_out.figures.as_ref().map_or(f64::NAN, |figures| 1e3 * figures.mean_m);
        let codes: Vec<&str> = found.findings.iter().map(|finding| finding.code.as_str()).collect();
        headlines.push(vec![
            name.clone(),
            format!("{own:.3}"),
            found.leave_one_out.name.clone(),
            best.map_or("-".to_owned(), |(method, figures)| format!("{:.3} ({method})", figures[0])),
            found.robot_noise.map_or("-".to_owned(), |noise| {
                format!("{:.3} deg, {:.2} mm", noise.rotation_rad.to_degrees(), 1e3 * noise.translation_m)
            }),
            found.median_sigma_m.map_or("-".to_owned(), |sigma| format!("{:.2}", 1e3 * sigma)),
            if codes.is_empty() { "-".to_owned() } else { codes.join(", ") },
        ]);
        let row = |method: String, figures: Option<[f64; 3]>| {
            let cells =
                figures.map_or(vec!["failed".to_owned()], |f| f.map(|mm| format!("{mm:.3}")).to_vec());
            [vec![format!("{name}, {method}")], cells].concat()
        };
        methods.extend(
            of_opencv.iter().map(|(method, figures)| row(format!("OpenCV {method}"), Some(*figures))),
        );
        methods.extend(found.methods.iter().map(|method| {
            let figures = method.figures.as_ref();
            row(method.name.clone(), figures.map(|f| [f.mean_m, f.p95_m, f.max_m].map(|metres| 1e3 * metres)))
        }));
    }
    let head = [
        "recording",
        "left-out mm",
        "by",
        "OpenCV's best",
        "robot noise per axis",
        "1 sigma in base, mm",
        "findings",
    ];
    let text = [
        markdown(&head, &headlines),
        markdown(&["recording, method", "mean mm", "95 % mm", "most mm"], &methods),
        poses::tables(&program)?,
        planar::table(&program)?,
    ]
    .join("\n");
    println!("{text}");
    if !keep_docs {
        table::rewrite(DOCS, COMMAND, &text)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs OpenCV's closed forms.
fn made_reference() -> anyhow::Result<Reference> {
    let python = std::env::var("BORESIGHT_OPENCV4_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut reference = command(&python);
    reference.args(["tools/reference/hand_eye_reference.py", SHARED, TAG_CORNERS]);
    let known: BTreeMap<String, serde_json::Value> =
        serde_json::from_str(&output(&mut reference)?).with_context(|| shown(&reference))?;
    let methods = |(name, rows): (String, serde_json::Value)| Ok((name, serde_json::from_value(rows)?));
    known.into_iter().map(methods).collect()
}

/// Reads OpenCV's figures from the table that a former run made.
fn kept_reference() -> anyhow::Result<Reference> {
    let text = std::fs::read_to_string(root().join(DOCS)).context(DOCS)?;
    let mut reference = Reference::new();
    for line in text.lines() {
        let cells: Vec<&str> = line.split('|').map(str::trim).filter(|cell| !cell.is_empty()).collect();
        let [first, figures @ ..] = &cells[..] else { continue };
        let Some((recording, method)) = first.split_once(", OpenCV ") else { continue };
        let numbers: Vec<f64> = figures.iter().filter_map(|cell| cell.parse().ok()).collect();
        if let Ok(figures) = <[f64; 3]>::try_from(numbers) {
            reference.entry(recording.to_owned()).or_default().insert(method.to_owned(), figures);
        }
    }
    if reference.is_empty() {
        bail!("{DOCS} has no figures of OpenCV to keep");
    }
    Ok(reference)
}

/// Returns the names of the jobs.
fn jobs() -> anyhow::Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(root().join(JOBS)).context(JOBS)? {
        let path = entry?.path();
        let is_hand_eye = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("handeye"));
        if is_hand_eye && path.join("boresight.toml").is_file() {
            names.extend(path.file_name().map(|name| name.to_string_lossy().into_owned()));
        }
    }
    names.sort();
    Ok(names)
}

/// Returns what came of a recording; a failed quality gate is one of its findings.
fn calibrate(program: &Path, name: &str) -> anyhow::Result<HandEye> {
    let text = calibrated(program, &Path::new(JOBS).join(name), name)?;
    serde_json::from_str(&text).with_context(|| name.to_owned())
}

/// Calibrates a job and returns its `hand-eye.json`.
fn calibrated(program: &Path, job: &Path, name: &str) -> anyhow::Result<String> {
    let out = target().join("robot").join(name);
    let mut calibrate = command(program);
    calibrate.args(["robot", "hand-eye"]).arg(job).arg("-o").arg(&out);
    let status = calibrate.stdout(std::io::stderr()).status().with_context(|| shown(&calibrate))?;
    if !matches!(status.code(), Some(0 | 1)) {
        bail!("{}: {status}", shown(&calibrate));
    }
    let path = out.join("hand-eye.json");
    std::fs::read_to_string(&path).with_context(|| path.display().to_string())
}
