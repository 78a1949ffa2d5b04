//! The solvers that are compared: built or found, or named as missing.

use std::path::PathBuf;
use std::process::Command;

use crate::bench::problems::Problem;
use crate::process::{command, example, reference_environment, run, succeeds, target};

/// OpenCV's joint solve of two cameras is dense in the frames' poses; more frames take minutes.
const OPENCV_PAIR_FRAMES: usize = 50;

const OURS: &str = "Boresight";
const MRCAL: &str = "mrcal";

/// A solver that is ready to run.
pub(crate) struct Solver {
    pub name: &'static str,
    program: PathBuf,
    /// The script, for interpreters.
    script: Option<&'static str>,
    /// Whether it is run in every round, or once because its problem is another one.
    pub is_interleaved: bool,
}

/// A solver that cannot be run here.
pub(crate) struct Missing {
    pub name: &'static str,
    /// The command that installs it.
    pub install: String,
}

/// Builds and finds the solvers; ours comes first.
pub(crate) fn prepare() -> anyhow::Result<(Vec<Solver>, Vec<Missing>)> {
    let mut solvers = vec![boresight()?];
    let mut missing = Vec::new();
    for found in [mrcal(), ceres(), opencv()] {
        match found {
            Ok(solver) => solvers.push(solver),
            Err(absent) => missing.push(absent),
        }
    }
    Ok((solvers, missing))
}

impl Solver {
    /// Tells whether the solver has the problem's lens.
    pub(crate) fn can_solve(&self, problem: &Problem) -> bool {
        problem.bin.is_some() || self.name == OURS || self.name == MRCAL
    }

    /// Returns the command that solves a problem `repeat` times and prints one line of JSON.
    pub(crate) fn command(&self, problem: &Problem, repeat: usize, threads: usize, first: bool) -> Command {
        let mut solve = command(&self.program);
        // No library underneath may start threads of its own.
        for variable in ["OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"] {
            solve.env(variable, "1");
        }
        let input = problem.bin.as_ref().filter(|_| self.name == "Ceres").unwrap_or(&problem.npz);
        solve.args(self.script).arg(input);
        if self.name == OURS {
            solve.args([threads.to_string(), repeat.to_string()]).arg(problem.lens);
            return solve;
        }
        solve.args(["--repeat", &repeat.to_string()]);
        if self.name == MRCAL && first {
            // Counting takes another solve, which is not timed.
            solve.arg("--count");
        }
        if self.name == "OpenCV" && problem.n_cameras == 2 {
            solve.args(["--frames", &OPENCV_PAIR_FRAMES.to_string()]);
        }
        solve
    }
}

fn boresight() -> anyhow::Result<Solver> {
    Ok(Solver { name: OURS, program: example("solve_problem")?, script: None, is_interleaved: true })
}

fn mrcal() -> Result<Solver, Missing> {
    let python = PathBuf::from("/usr/bin/python3");
    if succeeds(command(&python).args(["-c", "import mrcal"])) {
        let script = Some("tools/bench/mrcal_solve.py");
        return Ok(Solver { name: MRCAL, program: python, script, is_interleaved: true });
    }
    Err(Missing { name: MRCAL, install: "apt-get install mrcal python3-mrcal".to_owned() })
}

fn ceres() -> Result<Solver, Missing> {
    let folder = target().join("bench-ceres");
    let configured = command("cmake").args(["-S", "tools/bench/ceres", "-B"]).arg(&folder).output();
    let is_configured = configured.is_ok_and(|output| output.status.success());
    if is_configured && run(command("cmake").arg("--build").arg(&folder)).is_ok() {
        return Ok(Solver { name: "Ceres", program: folder.join("ba"), script: None, is_interleaved: true });
    }
    Err(Missing { name: "Ceres", install: "apt-get install libceres-dev cmake g++".to_owned() })
}

fn opencv() -> Result<Solver, Missing> {
    let folder = reference_environment();
    let python = folder.join("bin/python");
    let is_there =
        || succeeds(command(&python).args(["-c", "import cv2; assert cv2.__version__ == '5.0.0'"]));
    if !is_there() {
        eprintln!("bench: making {}", folder.display());
        let made = run(command("python3").args(["-m", "venv"]).arg(&folder));
        let pip = ["-m", "pip", "install", "--quiet", "-r", "tools/reference/requirements.txt"];
        let made = made.and_then(|()| run(command(&python).args(pip)));
        if made.is_err() || !is_there() {
            let folder = folder.display();
            let install = format!(
                "python3 -m venv {folder} && {folder}/bin/pip install -r tools/reference/requirements.txt"
            );
            return Err(Missing { name: "OpenCV", install });
        }
    }
    let script = Some("tools/bench/opencv_solve.py");
    Ok(Solver { name: "OpenCV", program: python, script, is_interleaved: false })
}
