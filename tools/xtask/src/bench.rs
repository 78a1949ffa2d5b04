//! `cargo xtask bench`: Boresight and its peers on the same problems, interleaved, with equal repeats.
//!
//! A round runs every solver on every problem once, so that a busy minute hits all of them. What the
//! peers are and how their problems differ is told in `tools/bench/README.md`.

mod answer;
mod measure;
mod problems;
mod report;
mod solvers;

use std::path::PathBuf;
use std::process::ExitCode;

use crate::arguments::Arguments;
use crate::table;

/// The file with the tables, and the command that makes them.
const DOCS: &str = "docs/performance.md";
const COMMAND: &str = "cargo xtask bench";

/// Measures and reports. Exit codes: 0 good, 1 a peer found another optimum, 2 nothing was measured.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let rounds = arguments.option::<usize>("--rounds")?.unwrap_or(5).max(1);
    let folder = arguments.option::<PathBuf>("--problems")?;
    let keep_docs = arguments.flag("--keep-docs");
    arguments.finish()?;

    let load = report::load_average();
    let (solvers, missing) = solvers::prepare()?;
    let problems = problems::prepare(folder)?;
    for missing in &missing {
        eprintln!("bench: {} is skipped, it is not installed: {}", missing.name, missing.install);
    }
    let measured = measure::measure(&solvers, &problems, rounds)?;
    let report = report::report(&measured, &missing, &load);
    println!("{}", report.text);
    for difference in &report.differences {
        eprintln!("bench: {difference}");
    }
    if keep_docs {
        eprintln!("bench: {DOCS} is left as it is");
    } else if missing.is_empty() {
        table::rewrite(DOCS, COMMAND, &report.text)?;
    } else {
        eprintln!("bench: {DOCS} is left as it is, because a peer is missing");
    }
    Ok(if report.differences.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}
