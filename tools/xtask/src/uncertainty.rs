//! `cargo xtask uncertainty`: the uncertainty map of one camera, ours and mrcal's, from the same problem.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use serde::Deserialize;

use crate::arguments::Arguments;
use crate::process::{command, example, output, root};
use crate::table;

/// The file with the table, and the command that makes it.
const DOCS: &str = "docs/performance.md";
const COMMAND: &str = "cargo xtask uncertainty";

/// The problem, unless told otherwise, and the camera and distance of the map.
const PROBLEM: &str = "../shared/conformance/mrcal/problems/c2_f200_b10_opencv8.npz";
const CAMERA: &str = "1";
const DISTANCES_M: [&str; 2] = ["1", "inf"];

/// Ours takes so little time that one measurement would be of the clock.
const OUR_REPEATS: &str = "20";

/// The rounds of both.
const ROUNDS: usize = 2;

/// How many times less CPU time ours must take, and how near the values must be, relatively.
const LEAST_RATIO: f64 = 500.0;
const CLOSE: f64 = 1e-4;

#[derive(Deserialize)]
struct Answer {
    cpu_s: f64,
    worst_px: Vec<Option<f64>>,
}

/// Measures both. Exit codes: 0 good, 1 too slow or different, 2 nothing was measured.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let problem = arguments.option::<PathBuf>("--problem")?.unwrap_or_else(|| root().join(PROBLEM));
    let keep_docs = arguments.flag("--keep-docs");
    arguments.finish()?;
    if !problem.is_file() {
        bail!("{} is not there", problem.display());
    }
    let ours = example("uncertainty_map")?;
    let mut is_good = true;
    let mut rows = Vec::new();
    for distance in DISTANCES_M {
        let (mut here, mut there) = (None, None);
        for _ in 0..ROUNDS {
            least(
                &mut here,
                answer(&mut *command(&ours).arg(&problem).args([CAMERA, distance, OUR_REPEATS]))?,
            );
            let mut python = command("/usr/bin/python3");
            python.arg("tools/bench/mrcal_uncertainty.py").arg(&problem).args([CAMERA, distance]);
            least(&mut there, answer(&mut python)?);
        }
        let (Some(here), Some(there)) = (here, there) else { bail!("no round was run") };
        let pairs = here.worst_px.iter().zip(&there.worst_px);
        let mut largest: f64 = 0.0;
        for pair in pairs {
            let (Some(here), Some(there)) = pair else { bail!("a point of the map has no value") };
            largest = largest.max((here / there - 1.0).abs());
        }
        let ratio = there.cpu_s / here.cpu_s;
        rows.push(vec![
            if distance == "inf" { "at infinity".to_owned() } else { format!("at {distance} m") },
            format!("{:.3}", 1e3 * here.cpu_s),
            format!("{:.1}", 1e3 * there.cpu_s),
            format!("{ratio:.0}"),
            format!("{largest:.1e}"),
        ]);
        is_good &= ratio >= LEAST_RATIO && largest <= CLOSE && here.worst_px.len() == there.worst_px.len();
    }
    let name = problem.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let text = format!(
        "A map of 60x40 pixels of camera {CAMERA} of `{name}`. One thread, the least times of {ROUNDS} interleaved rounds.\n\n{}",
        table::markdown(
            &["map", "Boresight CPU ms", "mrcal CPU ms", "times", "largest relative difference"],
            &rows,
        )
    );
    println!("{text}");
    if !keep_docs {
        table::rewrite(DOCS, COMMAND, &text)?;
    }
    Ok(if is_good { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Keeps the answer that took less time; all say the same of the map.
fn least(best: &mut Option<Answer>, answer: Answer) {
    if best.as_ref().is_none_or(|best| answer.cpu_s < best.cpu_s) {
        *best = Some(answer);
    }
}

fn answer(command: &mut std::process::Command) -> anyhow::Result<Answer> {
    let text = output(command)?;
    let line = text.lines().rfind(|line| line.starts_with('{')).context("no line of JSON was printed")?;
    Ok(serde_json::from_str(line)?)
}
