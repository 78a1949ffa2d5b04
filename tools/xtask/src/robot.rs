//! `cargo xtask robot`: the tables of `docs/robot.md`, by the tests that measure them.

use std::process::ExitCode;

use crate::arguments::Arguments;
use crate::process::{cargo, output};
use crate::table::{self, markdown};

const DOCS: &str = "docs/robot.md";
const COMMAND: &str = "cargo xtask robot";

/// Runs the measuring tests and writes their tables.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let keep_docs = arguments.flag("--keep-docs");
    arguments.finish()?;
    let plane = measured("boresight-adjust", &["--test", "touch"], "table_of_nine_touches")?;
    let rows: Vec<Vec<String>> = plane
        .lines()
        .filter_map(|line| line.split_once("row: "))
        .map(|(_, row)| row.split('|').map(|cell| cell.trim().to_owned()).collect())
        .collect();
    let head =
        ["tilt deg, k1", "similarity", "affine", "homography", "undistorted homography", "pose", "chosen"];
    let points = measured("boresight-seed", &["--test", "runner"], "a_million_poses")?;
    let facts = ["solutions 0 to 4", "error of points", "error of poses", "worst miss of a ray"];
    let listed: Vec<String> = points
        .lines()
        .filter(|line| facts.iter().any(|fact| line.starts_with(fact)) || line.contains("us each"))
        .map(|line| format!("    {}", line.trim_end_matches('.').trim_end()))
        .collect();
    let text = format!("{}\n{}\n", markdown(&head, &rows), listed.join("\n"));
    println!("{text}");
    if keep_docs {
        eprintln!("robot: {DOCS} is left as it is");
    } else {
        table::rewrite(DOCS, COMMAND, &text)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns what an ignored test prints.
fn measured(package: &str, binary: &[&str], test: &str) -> anyhow::Result<String> {
    let mut test_run = cargo();
    test_run.args(["test", "--release", "--quiet", "--package", package]).args(binary);
    output(test_run.args(["--", "--ignored", "--nocapture", test]))
}
