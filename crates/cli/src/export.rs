//! `boresight export`.

use std::process::ExitCode;

use boresight::{export, read_calibration, write_files};

use crate::arguments::ExportArguments;
use crate::failure::Failure;
use crate::streams::answer;

/// Writes a calibration in another format, and prints the files' names.
pub(crate) fn run(arguments: &ExportArguments) -> Result<ExitCode, Failure> {
    let (calibration, _) = read_calibration(&arguments.result)?;
    let files = export(&calibration, &arguments.to)?;
    write_files(&arguments.output, &files)?;
    let names: String =
        files.iter().map(|file| format!("{}\n", arguments.output.join(&file.name).display())).collect();
    answer(names.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}
