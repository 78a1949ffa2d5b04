//! The problems, as NumPy archives for most solvers and as plain binaries for Ceres.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};

use crate::bench::measure::REPEAT;
use crate::process::{command, example, output, reference_environment, root, run, succeeds, target};

/// Where the conformance data are, when they are beside the project.
const CONFORMANCE: &str = "../shared/conformance/mrcal/problems";

/// Label, cameras, frames: a camera alone, a pair, a rig. All have 10x10 boards and the lens opencv8.
const PROBLEMS: &[(&str, usize, usize)] = &[("1x50", 1, 50), ("2x200", 2, 200), ("8x200", 8, 200)];

/// Label, name and lens of a problem with a splined lens, which can only be had with the conformance
/// data. It has 14x14 boards; the core is held.
const SPLINED: (&str, &str, &str) = ("1x200 splined", "c1_f200_b14_splined", "splined3:30x18:120deg");

/// The same for a pair of cameras, which our `synthetic` makes: label, and cameras, frames, corners along each side of the
/// board, columns, rows and degrees of the spline.
const SPLINED_PAIR: (&str, [&str; 6]) = ("2x200 splined", ["2", "200", "14", "30", "18", "120"]);

/// A problem on disk.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    /// Cameras x frames.
    pub label: &'static str,
    pub n_cameras: usize,
    pub npz: PathBuf,
    /// For Ceres, which has no splined lens.
    pub bin: Option<PathBuf>,
    /// The lens model, as we call it.
    pub lens: &'static str,
    /// How often each process solves it, whoever it is.
    pub repeat: usize,
}

/// Problems that a peer takes a minute for are solved once.
const REPEAT_LONG: usize = 1;

/// Finds the problems in `folder` or in the conformance data, or makes such as there are none.
pub(crate) fn prepare(folder: Option<PathBuf>) -> anyhow::Result<Vec<Problem>> {
    let python = python_with_numpy().context("no Python with numpy: apt-get install python3-numpy")?;
    let beside = root().join(CONFORMANCE);
    let work = target().join("bench");
    std::fs::create_dir_all(&work).with_context(|| work.display().to_string())?;
    let mut problems = Vec::new();
    for &(label, n_cameras, n_frames) in PROBLEMS {
        let name = format!("c{n_cameras}_f{n_frames}_b10_opencv8");
        let given = folder.as_deref().unwrap_or(&beside).join(format!("{name}.npz"));
        let npz = if given.is_file() {
            given
        } else if folder.is_some() {
            bail!("{} does not exist", given.display());
        } else {
            let made = work.join(format!("made_{name}.npz"));
            eprintln!("bench: making {}, as {} is not there", made.display(), beside.display());
            let counts = ["--cameras", &n_cameras.to_string(), "--frames", &n_frames.to_string()];
            run(make_problem(&python).arg("make").arg(&made).args(counts))?;
            made
        };
        let bin = work.join(format!("{name}.bin"));
        run(make_problem(&python).arg("convert").arg(&npz).arg(&bin))?;
        problems.push(Problem { label, n_cameras, npz, bin: Some(bin), lens: "opencv8", repeat: REPEAT });
    }
    let (label, name, lens) = SPLINED;
    let npz = folder.as_deref().unwrap_or(&beside).join(format!("{name}.npz"));
    if npz.is_file() {
        problems.push(Problem { label, n_cameras: 1, npz, bin: None, lens, repeat: REPEAT });
    } else {
        eprintln!("bench: {label} is left out, {} does not exist", npz.display());
    }
    let (label, recipe) = SPLINED_PAIR;
    let npz = work.join("made_splined_pair.npz");
    synthesize(&python, &recipe, &npz)?;
    problems.push(Problem { label, n_cameras: 2, npz, bin: None, lens, repeat: REPEAT_LONG });
    Ok(problems)
}

/// Makes a problem by `synthetic`.
fn synthesize(python: &Path, recipe: &[&str], npz: &Path) -> anyhow::Result<()> {
    let arrays = npz.with_extension("json");
    let made = output(command(example("make_problem")?).args(recipe))?;
    std::fs::write(&arrays, made).with_context(|| arrays.display().to_string())?;
    run(make_problem(python).arg("pack").arg(&arrays).arg(npz))
}

fn make_problem(python: &Path) -> std::process::Command {
    let mut command = command(python);
    command.arg("tools/bench/make_problem.py");
    command
}

fn python_with_numpy() -> Option<PathBuf> {
    let candidates = [
        reference_environment().join("bin/python"),
        PathBuf::from("/usr/bin/python3"),
        PathBuf::from("python3"),
    ];
    candidates.into_iter().find(|python| succeeds(command(python).args(["-c", "import numpy"])))
}
