//! The `boresight` command: arguments in, an answer on stdout, everything else on stderr.
//!
//! Exit codes: 0 good; 1 written, but the verdict or a comparison failed; 2 usage or configuration;
//! 3 input unusable; 4 solve failed (diagnostics are written); 5 cannot write; 70 a bug; 130 stopped by Ctrl-C.
//!
//! Architecture invariant: nothing here computes; every number comes from the library.

mod arguments;
mod calibrate;
mod compare;
mod convert;
mod demo;
mod detect;
mod doctor;
mod explain;
mod export;
mod failure;
mod figures;
mod info;
mod init;
mod inputs;
mod matrix;
mod progress;
mod project;
mod robot;
mod stereo;
mod streams;
mod summary;
mod table;
mod target;
mod uncertainty;
mod validate;
mod verify;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser as _};

use crate::arguments::{Arguments, Command};
use crate::failure::Failure;

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(failure::report_bug));
    let arguments = Arguments::parse();
    match run(arguments.command) {
        Ok(code) => code,
        Err(failure) => failure.report(),
    }
}

fn run(command: Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Init(arguments) => init::run(&arguments),
        Command::Target { command } => target::run(&command),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Matrix(arguments) => matrix::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Uncertainty(arguments) => uncertainty::run(&arguments),
        Command::Validate(arguments) => validate::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Project(arguments) => project::project(&arguments),
        Command::Unproject(arguments) => project::unproject(&arguments),
        Command::Stereo(arguments) => stereo::run(&arguments),
        Command::Robot { command } => robot::run(&command),
        Command::Explain { code } => explain::run(code.as_deref()),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Arguments::command(), "boresight", &mut script);
            streams::answer(&script)?;
            Ok(ExitCode::SUCCESS)
        }
    }
}
