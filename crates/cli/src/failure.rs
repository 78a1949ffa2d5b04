//! Failures: one sentence, a hint, an exit code.

use std::panic::PanicHookInfo;
use std::process::ExitCode;

use boresight::ErrorKind;

use crate::streams::note;

/// The exit code of a bug: `EX_SOFTWARE` of sysexits.h.
const BUG: i32 = 70;

/// Why a command ends without its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reason {
    /// The command line or the job file asks for something that cannot be.
    Usage,
    /// The input cannot be used.
    Input,
    /// The solve failed.
    Solve,
    /// A result cannot be written.
    CannotWrite,
    /// Ctrl-C was pressed.
    Cancelled,
}

impl Reason {
    /// Returns the exit code.
    pub(crate) fn code(self) -> u8 {
        match self {
            Reason::Usage => 2,
            Reason::Input => 3,
            Reason::Solve => 4,
            Reason::CannotWrite => 5,
            Reason::Cancelled => 130,
        }
    }
}

/// A failure as it is shown.
#[derive(Debug)]
pub(crate) struct Failure {
    reason: Reason,
    message: String,
    hint: Option<String>,
}

impl Failure {
    /// Returns a failure without a hint.
    pub(crate) fn new(reason: Reason, message: impl Into<String>) -> Self {
        Self { reason, message: message.into(), hint: None }
    }

    /// Returns the failure with what to do about it.
    pub(crate) fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Returns the failure with what it is of before its message.
    pub(crate) fn of(mut self, what: &str) -> Self {
        self.message = format!("{what}: {}", self.message);
        self
    }

    /// Tells it on stderr and returns its exit code.
    pub(crate) fn report(&self) -> ExitCode {
        note(&format!("error: {}", self.message));
        if let Some(hint) = &self.hint {
            note(&format!("hint: {hint}"));
        }
        ExitCode::from(self.reason.code())
    }
}

impl From<boresight::IoError> for Failure {
    fn from(error: boresight::IoError) -> Self {
        boresight::Error::from(error).into()
    }
}

impl From<boresight::Error> for Failure {
    fn from(error: boresight::Error) -> Self {
        let reason = match error.kind() {
            ErrorKind::Usage => Reason::Usage,
            ErrorKind::Input => Reason::Input,
            ErrorKind::Solve => Reason::Solve,
            ErrorKind::CannotWrite => Reason::CannotWrite,
        };
        Self { reason, message: error.to_string(), hint: error.hint() }
    }
}

/// Tells of a bug and ends the process.
pub(crate) fn report_bug(info: &PanicHookInfo<'_>) {
    let message = info.payload_as_str().unwrap_or("no message");
    let place = info.location().map_or_else(|| "an unknown place".to_owned(), ToString::to_string);
    note(&format!("error: this is a bug in Boresight {}: {message} ({place})", boresight::VERSION));
    note(
        "hint: please report it with this line, the command line and, if you can, the input; nothing half-written is left",
    );
    std::process::exit(BUG);
}
