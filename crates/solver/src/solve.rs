//! Solves a problem.

use argmin::core::observers::{Observe, ObserverMode};
use argmin::core::{Executor, KV, KvValue, State as _, TerminationReason, TerminationStatus};

use crate::Error;
use crate::checkpoint::{Writer, first_state};
use crate::levenberg_marquardt::{Counters, LevenbergMarquardt, State};
use crate::options::{Observer, Progress, SolveOptions};
use crate::problem::{Problem, Values};
use crate::stop::Stop;
use crate::threads::Threads;

/// Where a search ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The values of all blocks.
    pub values: Vec<f64>,
    /// The cost there: the sum of squares, priors included. After [`Stop::PredictedDecrease`] the
    /// last step's share of it is the model's prediction.
    pub cost: f64,
    /// Why the search stopped.
    pub stop: Stop,
    /// What happened on the way.
    pub counters: Counters,
}

impl Solution {
    /// Returns the values for reading by block.
    pub fn values<'a>(&'a self, problem: &'a Problem<'_>) -> Values<'a> {
        problem.parameters.at(&self.values)
    }
}

/// Makes the problem's sum of squares least.
///
/// Not converging is not an error but a [`Stop`]; the values are then the best that were found.
pub fn solve(problem: &Problem<'_>, options: &SolveOptions) -> Result<Solution, Error> {
    solve_observed(problem, options, None)
}

/// Does what [`solve`] does and reports each iteration to `observer`.
pub fn solve_observed(
    problem: &Problem<'_>,
    options: &SolveOptions,
    observer: Option<Observer>,
) -> Result<Solution, Error> {
    let rows: usize = problem.terms.iter().map(|term| term.row_count()).sum();
    let unknowns = problem.parameters.free_count();
    if rows < unknowns {
        return Err(Error::TooFewRows { rows, unknowns });
    }
    let threads = Threads::new(options.threads, rows)?;
    threads.run(|| search(problem, options, observer, &threads))
}

fn search(
    problem: &Problem<'_>,
    options: &SolveOptions,
    observer: Option<Observer>,
    threads: &Threads,
) -> Result<Solution, Error> {
    let mut values = problem.parameters.values.clone();
    let mut search = LevenbergMarquardt::new(problem, &values, threads, options)?;
    let mut iteration = 0;
    let writer =
        options.checkpoint.as_ref().map(|checkpointing| Writer::new(checkpointing, problem, search.cost()));
    if let Some(writer) = &writer {
        match writer.read(values.len())? {
            Some(saved) => {
                search.resume(problem, &saved)?;
                (values, iteration) = (saved.values, saved.iteration);
            }
            // A place that cannot be written to should be known before the work, not after it.
            None => writer.write(&search, &values, iteration)?,
        }
    }
    let state = first_state(values, iteration).max_iters(options.max_iterations as u64);
    let mut executor = Executor::new(problem, search).configure(|_| state).timer(false).ctrlc(false);
    if let Some(limit) = options.time_limit {
        executor = executor.timeout(limit);
    }
    if let Some(writer) = &writer {
        executor = executor.checkpointing(writer.clone());
    }
    if let Some(report) = observer {
        executor = executor.add_observer(Reporter { report }, ObserverMode::Always);
    }
    let result = executor.run().map_err(|error| {
        error.downcast().unwrap_or_else(|error| Error::Checkpoint {
            path: options.checkpoint.as_ref().map(|c| c.path.display().to_string()).unwrap_or_default(),
            problem: error.to_string(),
        })
    })?;
    let (mut state, search) = (result.state, result.solver);
    let stop = search.stop.unwrap_or(match state.get_termination_status() {
        TerminationStatus::Terminated(TerminationReason::Timeout) => {
            Stop::TimeLimit { seconds: options.time_limit.unwrap_or_default().as_secs_f64() }
        }
        _ => Stop::Iterations { count: options.max_iterations },
    });
    let values = state.take_param().unwrap_or_default();
    // argmin knows no cost before the first iteration.
    let cost = if state.get_cost().is_finite() { state.get_cost() } else { search.cost() };
    if let Some(writer) = &writer
        && stop.is_interruption()
    {
        writer.write(&search, &values, iteration + search.counters.iterations as u64)?;
    }
    Ok(Solution { values, cost, stop, counters: search.counters })
}

/// Passes argmin's reports on.
struct Reporter {
    report: Observer,
}

impl Observe<State> for Reporter {
    fn observe_iter(&mut self, state: &State, kv: &KV) -> Result<(), argmin::core::Error> {
        let number = |key| match kv.get(key) {
            Some(KvValue::Float(value)) => Some(*value),
            _ => None,
        };
        // A search that stops without a step reports nothing.
        if let (Some(predicted_decrease), Some(damping)) = (number("predicted_decrease"), number("damping")) {
            let iteration = state.get_iter() as usize + 1;
            (self.report)(Progress { iteration, cost: state.get_cost(), predicted_decrease, damping });
        }
        Ok(())
    }
}
