//! `boresight explain`.

use std::process::ExitCode;

use boresight::{codes, explain};

use crate::failure::{Failure, Reason};
use crate::streams::answer;

/// Returns the first sentence of what a code means.
fn meaning(code: &str) -> String {
    let text = explain(code).unwrap_or_default();
    let text = text.trim_start_matches("What it means: ");
    let paragraph =
        text.split("\n\n").next().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(" ");
    match paragraph.split_once(". ") {
        Some((first, _)) => format!("{first}."),
        None => paragraph,
    }
}

/// Prints what a code means, or all codes.
pub(crate) fn run(code: Option<&str>) -> Result<ExitCode, Failure> {
    let text = match code {
        None => {
            let codes = codes();
            let width = codes.iter().map(|code| code.len()).max().unwrap_or(0);
            let line = |code: &&str| format!("{code:<width$}  {}", meaning(code));
            codes.iter().map(line).collect::<Vec<String>>().join("\n")
        }
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
