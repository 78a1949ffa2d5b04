//! `boresight matrix`.

use std::io::IsTerminal as _;
use std::process::ExitCode;

use boresight::{matrices_to_json, matrices_to_npy, matrices_to_text, read_calibration};

use crate::arguments::{MatrixArguments, MatrixFormat};
use crate::failure::{Failure, Reason};
use crate::streams::answer;

/// Prints P, M and H of each camera.
pub(crate) fn run(arguments: &MatrixArguments) -> Result<ExitCode, Failure> {
    let (calibration, _) = read_calibration(&arguments.result)?;
    let bytes = match arguments.format {
        MatrixFormat::Text => matrices_to_text(&calibration).into_bytes(),
        MatrixFormat::Json => matrices_to_json(&calibration),
        MatrixFormat::Npy if std::io::stdout().is_terminal() => {
            let message = "--format npy: stdout is a terminal and npy is binary";
            return Err(
                Failure::new(Reason::Usage, message).with_hint("send it to a file: ... --format npy > H.npy")
            );
        }
        MatrixFormat::Npy => matrices_to_npy(&calibration),
    };
    answer(&bytes)?;
    Ok(ExitCode::SUCCESS)
}
