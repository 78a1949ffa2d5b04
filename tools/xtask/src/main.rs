//! The project's chores: `cargo xtask COMMAND`.
//!
//! Architecture invariant: no chore links a crate of ours; what it needs of them it runs as a process.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a chore talks to the developer who runs it")]

mod arguments;
mod bench;
mod datasets;
mod detection;
mod hand_eye;
mod outliers;
mod picture;
mod process;
mod reference;
mod robot;
mod table;
mod tidy;
mod uncertainty;

use std::process::ExitCode;

use crate::arguments::Arguments;

/// A chore.
struct Command {
    name: &'static str,
    usage: &'static str,
    about: &'static str,
    run: fn(Arguments) -> anyhow::Result<ExitCode>,
}

/// All chores.
const COMMANDS: &[Command] = &[
    Command { name: "tidy", usage: "", about: "checks the rules of the house", run: tidy::run },
    Command {
        name: "bench",
        usage: "[--rounds N] [--problems DIR] [--keep-docs]",
        about: "measures Boresight and its peers, interleaved, and writes the tables of docs/performance.md",
        run: bench::run,
    },
    Command {
        name: "outliers",
        usage: "[--rounds N] [--keep-docs]",
        about: "solves problems with outliers, ours and mrcal with rejection, and writes a table of docs/performance.md",
        run: outliers::run,
    },
    Command {
        name: "uncertainty",
        usage: "[--problem FILE] [--keep-docs]",
        about: "compares an uncertainty map, ours and mrcal's, and writes a table of docs/performance.md",
        run: uncertainty::run,
    },
    Command {
        name: "reference",
        usage: "[--write]",
        about: "makes the references of the datasets again and compares them, or writes them",
        run: reference::run,
    },
    Command {
        name: "datasets",
        usage: "[--recorded [--program FILE]] [NAME...] [--keep-docs]",
        about: "calibrates the committed datasets, or the recorded ones beside them, and writes docs/datasets.md",
        run: datasets::run,
    },
    Command {
        name: "detection",
        usage: "[--datasets DIR] [--keep-docs]",
        about: "compares detectors on recorded images and writes the tables of docs/detection.md",
        run: detection::run,
    },
    Command {
        name: "picture",
        usage: "[--program FILE]",
        about: "draws the picture of the README",
        run: picture::run,
    },
    Command {
        name: "robot",
        usage: "[--keep-docs]",
        about: "measures the robot side on simulated data and writes the tables of docs/robot.md",
        run: robot::run,
    },
    Command {
        name: "hand-eye",
        usage: "[--keep-docs]",
        about: "calibrates the recorded robots and writes the tables of docs/hand-eye.md",
        run: hand_eye::run,
    },
];

fn main() -> ExitCode {
    let mut words = std::env::args().skip(1);
    let name = words.next().unwrap_or_default();
    let Some(command) = COMMANDS.iter().find(|command| command.name == name) else {
        eprintln!("usage: cargo xtask COMMAND\n");
        for Command { name, usage, about, .. } in COMMANDS {
            eprintln!("  {:<52} {about}", format!("{name} {usage}"));
        }
        return ExitCode::from(2);
    };
    (command.run)(Arguments::new(words.collect())).unwrap_or_else(|error| {
        eprintln!("cargo xtask {name}: {error:#}");
        ExitCode::from(2)
    })
}
