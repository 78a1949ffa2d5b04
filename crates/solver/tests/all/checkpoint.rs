//! Checkpoints: resuming ends with the bits of a search that was never stopped.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use boresight_solver::{
    Checkpointing, Elimination, Error, Observer, Parameters, Problem, Solution, SolveOptions, Stop, solve,
    solve_observed,
};

use super::support::{Clouds, Function, as_terms};

/// An empty folder of a test's own.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("solver-checkpoint").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("the target folder is writable");
    folder
}

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("the folder is there");
    let name = |entry: std::io::Result<fs::DirEntry>| entry.expect("it is readable").file_name();
    let mut names: Vec<String> = entries.map(|entry| name(entry).to_string_lossy().into_owned()).collect();
    names.sort_unstable();
    names
}

fn options(path: &Path, every: u64, max_iterations: usize) -> SolveOptions {
    let checkpoint = Some(Checkpointing { path: path.to_owned(), every });
    SolveOptions { max_iterations, checkpoint, ..SolveOptions::default() }
}

/// Rosenbrock's valley, with a third row against the others: it takes many steps, of which some are
/// rejected, and does not end with a cost of zero.
fn valley(start: [f64; 2], options: &SolveOptions, observer: Option<Observer>) -> Result<Solution, Error> {
    let mut parameters = Parameters::default();
    let block = parameters.add_vector(&start);
    let term = Function::new(&[block], 3, |values| {
        let x = values.vector(block);
        let (curve, line, sum) = (10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0], 0.1 * (x[0] + x[1]));
        Some(vec![vec![-20.0 * x[0], 10.0, curve], vec![-1.0, 0.0, line], vec![0.1, 0.1, sum]])
    });
    let problem = Problem::new(&parameters, vec![&term]).expect("the problem is sound");
    solve_observed(&problem, options, observer)
}

const START: [f64; 2] = [-1.2, 1.0];

fn run(options: &SolveOptions) -> Result<Solution, Error> {
    valley(START, options, None)
}

fn uninterrupted() -> Solution {
    let solution =
        run(&SolveOptions { max_iterations: 500, ..SolveOptions::default() }).expect("it can be solved");
    assert!(solution.stop.is_converged() && solution.counters.iterations > 15, "{solution:?}");
    assert!(solution.counters.rejected_steps > 0, "damping should have been at work: {solution:?}");
    solution
}

fn same(found: &Solution, expected: &Solution) {
    assert_eq!(found.stop, expected.stop);
    assert_eq!(found.cost.to_bits(), expected.cost.to_bits());
    let bits = |solution: &Solution| -> Vec<u64> { solution.values.iter().map(|x| x.to_bits()).collect() };
    assert_eq!(bits(found), bits(expected));
}

#[test]
fn resuming_ends_with_the_same_bits() {
    let expected = uninterrupted();
    for (name, every) in [("every-0", 0), ("every-1", 1), ("every-3", 3), ("every-100", 100)] {
        let folder = folder(name);
        let path = folder.join("search.json");
        // The limits of the run that wrote the file are not those of the run that reads it.
        for limit in [0, 1, 2, 11, 12, 500] {
            let solution = run(&options(&path, every, limit)).expect("it can be solved");
            if limit == 500 {
                same(&solution, &expected);
            } else {
                assert_eq!(solution.stop, Stop::Iterations { count: limit });
                let plain = SolveOptions { max_iterations: limit, ..SolveOptions::default() };
                same(&solution, &run(&plain).expect("it can be solved"));
            }
            assert_eq!(files(&folder), ["search.json"]);
        }
        // Resuming what has ended ends there again.
        same(&run(&options(&path, every, 500)).expect("it can be solved"), &expected);
        // A limit below what was done already returns what was done.
        let solution = run(&options(&path, every, 1)).expect("it can be solved");
        assert_eq!((solution.stop, solution.counters.iterations), (Stop::Iterations { count: 1 }, 0));
        assert!(solution.cost >= expected.cost && solution.cost < 24.0, "{solution:?}");
    }
}

#[test]
fn time_limits_and_cancelling_can_be_resumed() {
    let expected = uninterrupted();
    let path = folder("interrupted").join("search.json");
    for _ in 0..3 {
        let options = SolveOptions { time_limit: Some(Duration::ZERO), ..options(&path, 100, 500) };
        let solution = run(&options).expect("it can be solved");
        assert_eq!((solution.stop, solution.counters.iterations), (Stop::TimeLimit { seconds: 0.0 }, 1));
    }
    let cancel = Arc::new(AtomicBool::new(false));
    let cancellable = SolveOptions { cancel: Some(Arc::clone(&cancel)), ..options(&path, 100, 500) };
    let observer: Observer = Arc::new(move |progress| {
        // Iterations are counted from the very beginning, also for the observer.
        assert!(progress.iteration > 3);
        if progress.iteration == 10 {
            cancel.store(true, Ordering::Relaxed);
        }
    });
    let solution = valley(START, &cancellable, Some(observer)).expect("it can be solved");
    assert_eq!((solution.stop, solution.counters.iterations), (Stop::Cancelled, 7));
    let solution = run(&options(&path, 100, 12)).expect("it can be solved");
    assert_eq!((solution.stop, solution.counters.iterations), (Stop::Iterations { count: 12 }, 2));
    same(&run(&options(&path, 100, 500)).expect("it can be solved"), &expected);
}

#[test]
fn poses_are_resumed_too() {
    let clouds = Clouds::new(2, 6, 8, Elimination::First);
    let terms = clouds.terms();
    let problem = Problem::new(&clouds.parameters, as_terms(&terms)).expect("the problem is sound");
    let path = folder("poses").join("search.json");
    solve(&problem, &options(&path, 1, 2)).expect("it can be solved");
    let resumed = solve(&problem, &options(&path, 1, 100)).expect("it can be solved");
    same(&resumed, &solve(&problem, &SolveOptions::default()).expect("it can be solved"));
}

fn refused(result: Result<Solution, Error>, path: &Path) -> String {
    let error = result.expect_err("the checkpoint is refused");
    let Error::Checkpoint { path: named, problem } = &error else { panic!("{error:?}") };
    assert_eq!(named, &path.display().to_string());
    assert!(!problem.contains(named.as_str()), "the file is named twice: {error}");
    problem.clone()
}

#[test]
fn a_checkpoint_of_another_problem_is_refused_and_kept() {
    let path = folder("another").join("search.json");
    run(&options(&path, 1, 3)).expect("it can be solved");
    let before = fs::read(&path).expect("it was written");
    let mut start = START;
    start[1] += 1e-13;
    let problem = refused(valley(start, &options(&path, 1, 500), None), &path);
    assert!(problem.starts_with("it is of another problem"), "{problem}");
    assert_eq!(fs::read(&path).expect("it is still there"), before);
}

#[test]
fn what_is_no_checkpoint_is_refused_and_kept() {
    let folder = folder("corrupt");
    let path = folder.join("search.json");
    run(&options(&path, 1, 3)).expect("it can be solved");
    let sound = fs::read_to_string(&path).expect("it was written");
    let cases = [
        (String::new(), "not a checkpoint"),
        (sound[..sound.len() / 2].to_owned(), "not a checkpoint"),
        (sound.replace("\"damping\":", "\"damp\":"), "not a checkpoint"),
        (sound.replace("\"values\":[", "\"values\":[1.0,"), "it has 3 values, not 2"),
        (sound.replace("checkpoint/2", "checkpoint/1"), "its schema is"),
        (sound.replace("\"growth\":", "\"growth\":-"), "its damping"),
    ];
    for (text, expected) in cases {
        assert_ne!(text, sound);
        fs::write(&path, &text).expect("it is writable");
        let problem = refused(run(&options(&path, 1, 500)), &path);
        assert!(problem.starts_with(expected), "{problem}");
        assert_eq!(fs::read_to_string(&path).expect("it is still there"), text);
        assert_eq!(files(&folder), ["search.json"]);
    }
}

#[test]
fn a_place_that_cannot_be_written_to_is_known_at_once() {
    let folder = folder("unwritable");
    let unwritable = folder.join("missing").join("search.json");
    let evaluated = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&evaluated);
    let observer: Observer = Arc::new(move |_| seen.store(true, Ordering::Relaxed));
    refused(valley(START, &options(&unwritable, 1000, 500), Some(observer)), &unwritable);
    assert!(!evaluated.load(Ordering::Relaxed), "it searched first");
    // A folder under the file's name cannot be read.
    refused(run(&options(&folder, 1, 500)), &folder);
    assert!(files(&folder).is_empty(), "something half-written is left: {:?}", files(&folder));
}

#[test]
fn a_failure_to_write_on_the_way_leaves_nothing_half_written() {
    let folder = folder("failing");
    let path = folder.join("search.json");
    let place = path.clone();
    // A folder takes the file's place after the first iteration, so that renaming fails.
    let observer: Observer = Arc::new(move |progress| {
        if progress.iteration == 1 {
            fs::remove_file(&place).expect("it was written at the start");
            fs::create_dir(&place).expect("the folder is writable");
        }
    });
    refused(valley(START, &options(&path, 1, 500), Some(observer)), &path);
    assert_eq!(files(&folder), ["search.json"]);
}
