//! `boresight explain`.

use std::process::ExitCode;

use boresight::{codes, explain};

use crate::failure::{Failure, Reason};
use crate::streams::answer;

/// Prints what a code means, or all codes.
pub(crate) fn run(code: Option<&str>) -> Result<ExitCode, Failure> {
    let text = match code {
        None => codes().join("\n"),
        Some(code) => match explain(code) {
            Some(text) => format!("{code}\n\n{text}"),
            None => {
                let message = format!("there is no finding with the code `{code}`");
                let hint = format!("the codes are {}", codes().join(", "));
                return Err(Failure::new(Reason::Usage, message).with_hint(hint));
            }
        },
    };
    answer(format!("{text}\n").as_bytes())?;
    Ok(ExitCode::SUCCESS)
}
