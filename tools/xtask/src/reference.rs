//! `cargo xtask reference`: the datasets' references by other tools, made again and compared, or written.

use std::process::ExitCode;

use anyhow::Context as _;

use crate::arguments::Arguments;
use crate::process::{command, shown};

/// Compares fresh references with the committed ones, or writes them with `--write`.
///
/// Exit codes are the script's: 0 good, 1 a number differs, 2 something is not installed.
pub(crate) fn run(mut arguments: Arguments) -> anyhow::Result<ExitCode> {
    let write = arguments.flag("--write");
    arguments.finish()?;
    let mut script = command("python3");
    script.arg("tools/reference/reference.py");
    if !write {
        script.arg("--check");
    }
    let status = script.status().with_context(|| format!("{} (apt-get install python3)", shown(&script)))?;
    Ok(status.code().and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from))
}
