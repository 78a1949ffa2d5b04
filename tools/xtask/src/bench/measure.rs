//! Runs the rounds.

use std::thread;

use anyhow::{Context as _, bail};

use crate::bench::answer::Answer;
use crate::bench::problems::Problem;
use crate::bench::solvers::Solver;
use crate::process::{output, shown};

/// Every process solves its problem as often and reports its median, whoever it is; long ones once.
pub(crate) const REPEAT: usize = 3;

/// Where Boresight is measured alone, against the machine, each process solves as often.
pub(crate) const REPEAT_ALONE: usize = 15;

/// The problem on which two threads are held against one.
const THREADS_PROBLEM: &str = "8x200";

/// How often that is done: what neighbours of a virtual machine do to one of its cores is more than what is looked for.
const THREADS_ROUNDS: usize = 15;

/// What was measured.
pub(crate) struct Measured {
    pub rounds: usize,
    /// By problem, in their order.
    pub problems: Vec<MeasuredProblem>,
    pub threads: Option<Threads>,
}

pub(crate) struct MeasuredProblem {
    pub label: &'static str,
    /// For each solver its answers, a round each; ours first.
    pub solvers: Vec<(&'static str, Vec<Answer>)>,
    /// Our answers where we are alone, a round each.
    pub alone: Vec<Answer>,
}

/// Our answers with one thread and with two, a round each.
pub(crate) struct Threads {
    pub label: &'static str,
    pub one: Vec<Answer>,
    pub two: Vec<Answer>,
    /// Those of two processes at once, with a thread each: what the machine has to give to a second thread.
    pub apart: Vec<[Answer; 2]>,
}

/// Runs all solvers on all problems in each round.
pub(crate) fn measure(solvers: &[Solver], problems: &[Problem], rounds: usize) -> anyhow::Result<Measured> {
    let mut measured: Vec<MeasuredProblem> = problems
        .iter()
        .map(|problem| MeasuredProblem {
            label: problem.label,
            solvers: solvers.iter().map(|solver| (solver.name, Vec::new())).collect(),
            alone: Vec::new(),
        })
        .collect();
    let ours = solvers.first().context("there is no solver")?;
    for round in 0..rounds {
        for (problem, measured) in problems.iter().zip(&mut measured) {
            eprintln!("bench: round {} of {rounds}, {}", round + 1, problem.label);
            for (solver, (_, answers)) in solvers.iter().zip(&mut measured.solvers) {
                if solver.can_solve(problem) && (round == 0 || solver.is_interleaved) {
                    answers.push(solve(solver, problem, problem.repeat, 1, round == 0)?);
                }
            }
            measured.alone.push(solve(ours, problem, REPEAT_ALONE, 1, false)?);
        }
    }
    let threads = problems.iter().find(|problem| problem.label == THREADS_PROBLEM);
    let threads = threads.map(|problem| measure_threads(ours, problem)).transpose()?;
    Ok(Measured { rounds, problems: measured, threads })
}

/// Solves a problem with one thread, with two, and in two processes at once, in turns.
fn measure_threads(ours: &Solver, problem: &Problem) -> anyhow::Result<Threads> {
    let mut threads = Threads { label: problem.label, one: Vec::new(), two: Vec::new(), apart: Vec::new() };
    for round in 0..THREADS_ROUNDS {
        eprintln!("bench: threads, round {} of {THREADS_ROUNDS}, {}", round + 1, problem.label);
        let alone = || solve(ours, problem, REPEAT_ALONE, 1, false);
        threads.one.push(alone()?);
        threads.two.push(solve(ours, problem, REPEAT_ALONE, 2, false)?);
        let [first, second] = thread::scope(|scope| {
            let other = scope.spawn(alone);
            [alone(), other.join().unwrap_or_else(|_| bail!("a process was not waited for"))]
        });
        threads.apart.push([first?, second?]);
    }
    Ok(threads)
}

fn solve(
    solver: &Solver,
    problem: &Problem,
    repeat: usize,
    threads: usize,
    first: bool,
) -> anyhow::Result<Answer> {
    let mut command = solver.command(problem, repeat, threads, first);
    let text = output(&mut command)?;
    let Some(line) = text.lines().rfind(|line| line.starts_with('{')) else {
        bail!("{} printed no line of JSON", shown(&command));
    };
    serde_json::from_str(line).with_context(|| format!("{} printed {line}", shown(&command)))
}
