//! `cargo xtask detection`: compares detectors on recorded sets and writes the tables of `docs/detection.md`.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use serde::Deserialize;

use crate::arguments::Arguments;
use crate::process::{command, example, output, reference_environment};
use crate::table::{self, markdown};

const DOCS: &str = "docs/detection.md";
const COMMAND: &str = "cargo xtask detection";
const DATASETS: &str = "../shared/datasets";

#[derive(Deserialize)]
struct Answers {
    opencv: String,
    chess: Vec<Answer>,
    charuco: Vec<Answer>,
}

#[derive(Deserialize)]
struct Answer {
    set: String,
    images: usize,
    size: [u32; 2],
    views: usize,
    corners: usize,
    rms: BTreeMap<String, f64>,
    found: BTreeMap<String, usize>,
    seconds: BTreeMap<String, f64>,
}

/// Measures all sets that are there. `BORESIGHT_REFENV` is the folder of a Python environment with OpenCV 5.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let keep_docs = arguments.flag("--keep-docs");
    let datasets = arguments.option::<PathBuf>("--datasets")?.unwrap_or_else(|| PathBuf::from(DATASETS));
    arguments.finish()?;
    if !datasets.is_dir() {
        bail!("{} is not there", datasets.display());
    }
    let program = example("detect_images")?;
    let mut python = command(reference_environment().join("bin/python"));
    let text = output(python.arg("tools/bench/detection.py").arg(&program).arg(&datasets))?;
    let line = text.lines().rfind(|line| line.starts_with('{')).context("no line of JSON was printed")?;
    let answers: Answers = serde_json::from_str(line)?;
    let made = tables(&answers);
    print!("{made}");
    if !keep_docs {
        table::rewrite(DOCS, COMMAND, &made)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn tables(answers: &Answers) -> String {
    let of = |map: &BTreeMap<String, f64>, key: &str| map.get(key).copied().unwrap_or(f64::NAN);
    let ms = |answer: &Answer, key: &str| 1e3 * of(&answer.seconds, key) / answer.images.max(1) as f64;
    let found = |answer: &Answer, key: &str| answer.found.get(key).copied().unwrap_or(0).to_string();
    let chess: Vec<Vec<String>> = answers
        .chess
        .iter()
        .map(|answer| {
            vec![
                format!("{}, {}x{}", answer.set, answer.size[0], answer.size[1]),
                format!("{} / {} / {}", found(answer, "ours"), found(answer, "classic"), found(answer, "sb")),
                format!("{} in {}", answer.corners, answer.views),
                format!("{:.4}", of(&answer.rms, "ours")),
                format!("{:.4}", of(&answer.rms, "subpix8")),
                format!("{:.4}", of(&answer.rms, "sb")),
                format!("{:.1}", ms(answer, "ours")),
                format!("{:.1}", ms(answer, "classic")),
                format!("{:.1}", ms(answer, "sb")),
            ]
        })
        .collect();
    let charuco: Vec<Vec<String>> = answers
        .charuco
        .iter()
        .map(|answer| {
            vec![
                format!("{}, {}x{}", answer.set, answer.size[0], answer.size[1]),
                format!("{} / {}", found(answer, "ours"), found(answer, "opencv")),
                format!("{} in {}", answer.corners, answer.views),
                format!("{:.4}", of(&answer.rms, "ours")),
                format!("{:.4}", of(&answer.rms, "subpix8")),
                format!("{:.4}", of(&answer.rms, "opencv")),
                format!("{:.1}", ms(answer, "ours")),
                format!("{:.1}", ms(answer, "opencv")),
            ]
        })
        .collect();
    let chess_head = [
        "chessboards",
        "whole: ours / classic / SB",
        "corners compared",
        "RMS px ours",
        "cornerSubPix(8)",
        "SB",
        "ms an image ours",
        "classic + cornerSubPix(8)",
        "SB",
    ];
    let charuco_head = [
        "ChArUco boards",
        "found: ours / OpenCV",
        "corners compared",
        "RMS px ours",
        "cornerSubPix(8)",
        "OpenCV",
        "ms an image ours",
        "OpenCV",
    ];
    format!(
        "OpenCV {}; CPU time on one thread.\n\n{}\n{}",
        answers.opencv,
        markdown(&chess_head, &chess),
        markdown(&charuco_head, &charuco)
    )
}
