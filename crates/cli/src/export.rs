//! `boresight export`.

use std::process::ExitCode;

use boresight::{
    OutputFile, calibration_to_mcap, export, lost_in, read_calibration, read_observations, write_files,
};

use crate::arguments::ExportArguments;
use crate::failure::Failure;
use crate::streams::{answer, note};

/// The file beside a calibration that has its corners.
const OBSERVATIONS: &str = "observations.parquet";

/// Writes a calibration in another format, and prints the files' names.
pub(crate) fn run(arguments: &ExportArguments) -> Result<ExitCode, Failure> {
    let (calibration, _) = read_calibration(&arguments.result)?;
    let beside = if arguments.result.is_dir() {
        arguments.result.join(OBSERVATIONS)
    } else {
        arguments.result.with_file_name(OBSERVATIONS)
    };
    let files = if arguments.to == "mcap" && beside.is_file() {
        let bytes = calibration_to_mcap(&calibration, &read_observations(&beside)?)?;
        vec![OutputFile { name: "calibration.mcap".to_owned(), bytes }]
    } else {
        export(&calibration, &arguments.to)?
    };
    write_files(&arguments.output, &files)?;
    lost_in(&calibration, &arguments.to).iter().for_each(|line| note(&format!("note: {line}")));
    let names: String =
        files.iter().map(|file| format!("{}\n", arguments.output.join(&file.name).display())).collect();
    answer(names.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}
