//! `cargo xtask outliers`: problems with outliers, solved with rejection by us and by mrcal, interleaved.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use serde::Deserialize;

use crate::arguments::Arguments;
use crate::process::{command, example, output, root};
use crate::table;

/// The file with the table, and the command that makes it.
const DOCS: &str = "docs/performance.md";
const COMMAND: &str = "cargo xtask outliers";

/// Where the problems are, which must be beside the project, and their labels: cameras x frames, and the board.
const PROBLEMS: &str = "../shared/conformance/mrcal/problems";
const NAMES: &[(&str, &str)] = &[
    ("1x50, 10x10", "c1_f50_b10"),
    ("1x50, 14x14", "c1_f50_b14"),
    ("1x1000, 10x10", "c1_f1000_b10"),
    ("2x50, 10x10", "c2_f50_b10"),
    ("2x200, 10x10", "c2_f200_b10"),
    ("8x50, 10x10", "c8_f50_b10"),
    ("8x200, 10x10", "c8_f200_b10"),
];

/// How many times less CPU time ours must take, and the share of good corners that may be lost.
const LEAST_RATIO: f64 = 50.0;
const MOST_LOST_PERCENT: f64 = 0.1;

#[derive(Deserialize)]
struct Answer {
    cpu_s: f64,
    /// Ours alone has the following.
    #[serde(default)]
    cpu_s_with_report: f64,
    #[serde(default)]
    evaluations: usize,
    #[serde(default)]
    missed: usize,
    #[serde(default)]
    good_lost: usize,
    #[serde(default)]
    good_lost_percent: f64,
    #[serde(default)]
    above_5_sigma: usize,
}

/// Measures both. Exit codes: 0 good, 1 too slow or an outlier missed, 2 nothing was measured.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let rounds = arguments.option::<usize>("--rounds")?.unwrap_or(3).max(1);
    let keep_docs = arguments.flag("--keep-docs");
    arguments.finish()?;
    let ours = example("reject_outliers")?;
    let mut rows = Vec::new();
    let mut is_good = true;
    for &(label, name) in NAMES {
        let problem = root().join(PROBLEMS).join(format!("{name}_opencv8.npz"));
        if !problem.is_file() {
            bail!("{} is not there", problem.display());
        }
        let (mut here, mut there) = (None, None);
        for _ in 0..rounds {
            least(&mut here, answer(command(&ours).arg(&problem))?);
            let mut python = command(PathBuf::from("/usr/bin/python3"));
            least(&mut there, answer(python.arg("tools/bench/mrcal_reject.py").arg(&problem))?);
        }
        let (Some(here), Some(there)) = (here, there) else { bail!("no round was run") };
        let ratio = there.cpu_s / here.cpu_s;
        is_good &= ratio >= LEAST_RATIO && here.missed == 0 && here.good_lost_percent <= MOST_LOST_PERCENT;
        rows.push(vec![
            label.to_owned(),
            format!("{:.2}", 1e3 * here.cpu_s),
            format!("{:.2}", 1e3 * here.cpu_s_with_report),
            format!("{:.1}", 1e3 * there.cpu_s),
            format!("{ratio:.0}"),
            here.evaluations.to_string(),
            format!("{} of {}", here.missed, here.above_5_sigma),
            here.good_lost.to_string(),
            there.good_lost.to_string(),
        ]);
        eprintln!("outliers: {label}: {ratio:.0} times");
    }
    let head = [
        "problem",
        "CPU ms",
        "with report",
        "mrcal CPU ms",
        "times",
        "evaluations",
        "missed",
        "good lost",
        "mrcal's",
    ];
    let text = format!(
        "One thread, the least times of {rounds} interleaved rounds. Ours solves each problem nine times a round, mrcal three times.\n\n{}",
        table::markdown(&head, &rows)
    );
    println!("{text}");
    if !keep_docs {
        table::rewrite(DOCS, COMMAND, &text)?;
    }
    Ok(if is_good { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Keeps the answer that took less time; all say the same of the outliers.
fn least(best: &mut Option<Answer>, mut answer: Answer) {
    if let Some(best) = best {
        answer.cpu_s = answer.cpu_s.min(best.cpu_s);
        answer.cpu_s_with_report = answer.cpu_s_with_report.min(best.cpu_s_with_report);
    }
    *best = Some(answer);
}

fn answer(command: &mut std::process::Command) -> anyhow::Result<Answer> {
    let text = output(command)?;
    let line = text.lines().rfind(|line| line.starts_with('{')).context("no line of JSON was printed")?;
    Ok(serde_json::from_str(line)?)
}
