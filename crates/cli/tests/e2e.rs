//! The command from end to end, on the committed datasets.

#![allow(clippy::unwrap_used, reason = "a test may stop at what it does not expect")]

#[path = "e2e/bad_inputs.rs"]
mod bad_inputs;
#[path = "e2e/begin.rs"]
mod begin;
#[path = "e2e/calibrate.rs"]
mod calibrate;
#[path = "e2e/doctor.rs"]
mod doctor;
#[path = "e2e/hand_eye.rs"]
mod hand_eye;
#[path = "e2e/images.rs"]
mod images;
#[path = "e2e/recordings.rs"]
mod recordings;
#[path = "e2e/results.rs"]
mod results;
#[path = "e2e/robot.rs"]
mod robot;

use std::path::{Path, PathBuf};

/// What a run of the command came to.
struct Run {
    code: Option<i32>,
    stdout: Vec<u8>,
    stderr: String,
}

impl Run {
    fn text(&self) -> String {
        String::from_utf8(self.stdout.clone()).unwrap()
    }

    /// Returns stdout of a run that must have succeeded.
    fn good(self) -> String {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        self.text()
    }
}

fn boresight(folder: &Path, arguments: &[&str]) -> Run {
    boresight_with_input(folder, arguments, "")
}

fn boresight_with_input(folder: &Path, arguments: &[&str], stdin: &str) -> Run {
    let mut command = assert_cmd::Command::cargo_bin("boresight").unwrap();
    let output = command.current_dir(folder).args(arguments).write_stdin(stdin).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    Run { code: output.status.code(), stdout: output.stdout, stderr }
}

fn dataset(path: &str) -> String {
    let datasets: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets");
    datasets.join(path).display().to_string()
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}
