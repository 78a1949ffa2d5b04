//! The two streams: the answer on stdout, everything else on stderr.

use std::io::{ErrorKind, Write as _, stderr, stdout};

use crate::failure::{Failure, Reason};

/// Writes the answer to stdout. A reader that has seen enough is no failure.
pub(crate) fn answer(bytes: &[u8]) -> Result<(), Failure> {
    let mut out = stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::new(Reason::CannotWrite, format!("stdout: cannot be written: {error}")))
        }
        _ => Ok(()),
    }
}

/// Writes a document to stdout as JSON.
pub(crate) fn json(document: &impl serde::Serialize) -> Result<(), Failure> {
    let mut bytes = serde_json::to_vec_pretty(document)
        .map_err(|error| Failure::new(Reason::CannotWrite, format!("stdout: cannot be written: {error}")))?;
    bytes.push(b'\n');
    answer(&bytes)
}

/// Writes a line to stderr; nobody is left to hear of it if that fails.
pub(crate) fn note(line: &str) {
    let _ = writeln!(stderr().lock(), "{line}");
}
