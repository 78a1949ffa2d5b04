//! `cargo xtask datasets`: calibrates the committed datasets and writes the tables of `docs/datasets.md`.

mod recorded;
mod recorded_sets;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use serde::Deserialize;

use crate::arguments::Arguments;
use crate::process::{boresight, command, root, shown, target};
use crate::table::{self, markdown};

const DOCS: &str = "docs/datasets.md";
const COMMAND: &str = "cargo xtask datasets";

/// What the tables show of a `calibration.json`.
#[derive(Debug, Deserialize)]
struct Calibration {
    rms_px: serde_json::Value,
    stop: String,
    cameras: Vec<Camera>,
    #[serde(default)]
    baselines_m: BTreeMap<String, Estimate>,
}

#[derive(Debug, Deserialize)]
struct Camera {
    name: String,
    model: Option<String>,
    params: Option<BTreeMap<String, Estimate>>,
    rms_px: serde_json::Value,
    views: usize,
    observations: usize,
    rejected: usize,
}

#[derive(Debug, Deserialize)]
struct Estimate {
    value: serde_json::Value,
    sigma: Option<serde_json::Value>,
}

/// Calibrates the named datasets, or all; or the recorded ones beside the project. Exit codes: 0 good, 1 a quality gate failed.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let keep_docs = arguments.flag("--keep-docs");
    let of_recorded = arguments.flag("--recorded");
    let program = arguments.option("--program")?;
    let named = arguments.rest()?;
    if of_recorded {
        return recorded::run(&named, program, keep_docs);
    }
    let all = committed()?;
    if let Some(unknown) = named.iter().find(|name| !all.contains(name)) {
        bail!("{unknown} is no dataset; there are {}", all.join(", "));
    }
    let is_whole = named.is_empty();
    let names = if is_whole { all } else { named };

    let program = boresight()?;
    let (mut cameras, mut solves, mut all_good) = (Vec::new(), Vec::new(), true);
    for name in &names {
        let (calibration, passed) = calibrate(&program, name)?;
        all_good &= passed;
        cameras.extend(camera_rows(name, &calibration));
        let gate = if passed { "passed" } else { "failed" };
        solves.push(vec![
            name.clone(),
            number(&calibration.rms_px, 6),
            gate.to_owned(),
            calibration.stop.clone(),
        ]);
    }
    let head = [
        "dataset, camera",
        "lens",
        "views",
        "corners",
        "rejected",
        "RMS px",
        "fx",
        "fy",
        "cx",
        "cy",
        "baseline m",
    ];
    let text = [
        markdown(&["dataset", "RMS px", "gates", "why the solve stopped"], &solves),
        markdown(&head, &cameras),
    ]
    .join("\n");
    println!("{text}");
    if keep_docs || !is_whole {
        eprintln!("datasets: {DOCS} is left as it is");
    } else {
        table::rewrite(DOCS, COMMAND, &text)?;
    }
    Ok(if all_good { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Returns the names of the committed datasets.
fn committed() -> anyhow::Result<Vec<String>> {
    let folder = root().join("datasets");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        // The jobs of robot commands have no corners to calibrate from.
        let job = std::fs::read_to_string(entry.path().join("boresight.toml")).unwrap_or_default();
        if job.lines().any(|line| line.trim() == "[input]") {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}

/// Returns a dataset's calibration, and whether it passed its quality gates.
fn calibrate(program: &Path, name: &str) -> anyhow::Result<(Calibration, bool)> {
    let out = target().join("datasets").join(name);
    let mut calibrate = command(program);
    calibrate.arg("calibrate").arg(Path::new("datasets").join(name)).arg("-o").arg(&out);
    // What it prints is for people.
    let status = calibrate.stdout(std::io::stderr()).status().with_context(|| shown(&calibrate))?;
    let passed = match status.code() {
        Some(0) => true,
        Some(1) => false,
        _ => bail!("{}: {status}", shown(&calibrate)),
    };
    let path = out.join("calibration.json");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    Ok((serde_json::from_str(&text).with_context(|| path.display().to_string())?, passed))
}

fn camera_rows(dataset: &str, calibration: &Calibration) -> Vec<Vec<String>> {
    let row = |camera: &Camera| {
        let param = |name: &str| camera.params.as_ref().and_then(|params| params.get(name));
        let mut row = vec![
            format!("{dataset}, {}", camera.name),
            camera.model.clone().unwrap_or_else(|| "none".to_owned()),
            camera.views.to_string(),
            camera.observations.to_string(),
            camera.rejected.to_string(),
            number(&camera.rms_px, 6),
        ];
        row.extend(["fx", "fy", "cx", "cy"].map(|name| estimate(param(name), 3)));
        row.push(estimate(calibration.baselines_m.get(&camera.name), 6));
        row
    };
    calibration.cameras.iter().map(row).collect()
}

fn estimate(estimate: Option<&Estimate>, decimals: usize) -> String {
    let Some(Estimate { value, sigma }) = estimate else { return "-".to_owned() };
    match sigma.as_ref().and_then(|sigma| sigma.as_f64()) {
        Some(sigma) => format!("{} ± {sigma:.decimals$}", number(value, decimals)),
        None => number(value, decimals),
    }
}

/// Returns a number as it is shown; one that is not finite is stored as something else.
fn number(value: &serde_json::Value, decimals: usize) -> String {
    value.as_f64().map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_shown_with_what_is_known_of_them() {
        let text = r#"{ "schema": "boresight.calibration/1", "rms_px": 0.2151, "stop": "converged",
            "cameras": [
                { "name": "left", "model": "opencv5", "params": { "fx": { "value": 535.91, "sigma": 0.05 } },
                  "rms_px": 0.2, "views": 13, "observations": 702, "rejected": 0 },
                { "name": "right", "model": null, "params": null,
                  "rms_px": { "value": null, "reason": "NaN" }, "views": 0, "observations": 0, "rejected": 0 }
            ],
            "baselines_m": { "right": { "value": 0.0834, "sigma": 0.00002 } } }"#;
        let rows = camera_rows("pair", &serde_json::from_str(text).unwrap());
        assert_eq!(rows[0][..7], ["pair, left", "opencv5", "13", "702", "0", "0.200000", "535.910 ± 0.050"]);
        assert_eq!(rows[0][10], "-");
        assert_eq!(rows[1][1..7], ["none", "0", "0", "0", "-", "-"]);
        assert_eq!(rows[1][10], "0.083400 ± 0.000020");
    }
}
