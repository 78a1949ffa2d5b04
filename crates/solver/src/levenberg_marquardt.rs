//! Levenberg-Marquardt as an argmin solver over our own state.
//!
//! Gain-ratio damping after Nielsen 1999 with a floor, Marquardt's scaling by the diagonal. Rejected
//! steps are retried within an iteration, so the cost never rises from one to the next.

use std::sync::atomic::Ordering;

use argmin::core::{IterState, KV, Solver, State as _, TerminationReason};
use argmin::kv;

use crate::Error;
use crate::checkpoint::Saved;
use crate::gradient::Gradient;
use crate::kept_model::{KeptModel, Origin};
use crate::linearization::{Failure, Linearization};
use crate::options::{SlowEnd, SolveOptions};
use crate::problem::Problem;
use crate::step::StepSolver;
use crate::stop::Stop;
use crate::structure::Structure;
use crate::threads::Threads;

/// Damping below this changes nothing but makes the next rejections come in bursts.
const LEAST_DAMPING: f64 = 1e-12;

/// What a perfect step lowers the damping to, of itself.
const LEAST_SHRINK: f64 = 0.004;

/// Damping beyond this means that no step, however short, lowers the cost.
const MOST_DAMPING: f64 = 1e12;

/// Where a model is worth keeping: the share of the cost that it may at most predict as a decrease, and
/// the least share of its own prediction that the last one must have kept.
const KEEP_BELOW: f64 = 1e-4;
const KEEP_GAIN: f64 = 0.75;

/// A search that promises more than this share of what the step before promised is slow: what Gauss and Newton leave out
/// counts, and may be learnt along a model that is kept if the last step kept that share of its own prediction.
const SLOW_SHARE: f64 = 0.1;
const SLOW_GAIN: f64 = 0.3;

/// A root mean square residual below this is met exactly, in units of sigma.
const EXACT_RMS: f64 = 1e-11;

/// A predicted decrease below this share of the cost is lost in its rounding.
const ROUNDING: f64 = 1e-14;

/// The state that argmin carries: all values of all blocks, and the cost.
pub(crate) type State = IterState<Vec<f64>, (), (), (), (), f64>;

/// What happened on the way; after a resume, since then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Steps taken.
    pub iterations: usize,
    /// Evaluations of all terms.
    pub evaluations: usize,
    /// Factorizations of the reduced system.
    pub factorizations: usize,
    /// Steps refused because the cost rose, a term was not defined, or the system was not positive definite.
    pub rejected_steps: usize,
}

/// The search.
pub(crate) struct LevenbergMarquardt<'a> {
    options: &'a SolveOptions,
    /// The number of rows that are observations, and by how many they exceed what is free.
    n_rows: usize,
    degrees_of_freedom: usize,
    structure: Structure,
    threads: &'a Threads,
    model: Linearization,
    trial: Linearization,
    steps: StepSolver,
    trial_values: Vec<f64>,
    /// The damping of the next step.
    pub damping: f64,
    /// What the damping grows by when that step is rejected.
    pub growth: f64,
    /// The gain of the last step, in shares of its prediction.
    pub gain: f64,
    /// The decrease that the last step of a model of its own promised.
    pub promised: f64,
    /// Where the structure was made; nothing if that is where the problem starts.
    pub support_values: Vec<f64>,
    gradient: Gradient,
    /// The end of the search, along a model that is kept.
    kept: Option<KeptModel>,
    pub stop: Option<Stop>,
    pub counters: Counters,
}

impl<'a> LevenbergMarquardt<'a> {
    /// Returns a search from `values`, where the model is evaluated.
    pub(crate) fn new(
        problem: &Problem<'_>,
        values: &[f64],
        threads: &'a Threads,
        options: &'a SolveOptions,
    ) -> Result<Self, Error> {
        let structure = Structure::new(problem, values);
        let n_rows = problem.observation_rows();
        let mut search = Self {
            options,
            n_rows,
            degrees_of_freedom: n_rows.saturating_sub(problem.parameters.free_count()).max(1),
            threads,
            model: Linearization::new(&structure),
            trial: Linearization::new(&structure),
            steps: StepSolver::new(&structure),
            trial_values: Vec::with_capacity(values.len()),
            gain: 0.0,
            promised: f64::MAX,
            support_values: Vec::new(),
            gradient: Gradient::new(&structure),
            kept: None,
            structure,
            damping: options.first_damping,
            growth: 2.0,
            stop: None,
            counters: Counters::default(),
        };
        search.move_to(problem, values)?;
        Ok(search)
    }

    /// Evaluates the model at `values`, from where the next step is taken.
    pub(crate) fn move_to(&mut self, problem: &Problem<'_>, values: &[f64]) -> Result<(), Error> {
        self.counters.evaluations += 1;
        let Self { structure, threads, model, .. } = self;
        match model.evaluate(problem, structure, values, threads) {
            Err(Failure::OutsideSupport) => {
                self.find_supports(problem, values);
                let Self { structure, threads, model, .. } = self;
                Ok(model.evaluate(problem, structure, values, threads)?)
            }
            outcome => Ok(outcome?),
        }
    }

    /// Makes the structure that fits the terms' supports at `values`.
    fn find_supports(&mut self, problem: &Problem<'_>, values: &[f64]) {
        self.structure = Structure::new(problem, values);
        self.model = Linearization::new(&self.structure);
        self.trial = Linearization::new(&self.structure);
        self.steps = StepSolver::new(&self.structure);
        self.support_values = values.to_vec();
    }

    /// Goes on where a checkpoint was written.
    pub(crate) fn resume(&mut self, problem: &Problem<'_>, saved: &Saved) -> Result<(), Error> {
        (self.damping, self.growth) = (saved.damping, saved.growth);
        (self.gain, self.promised) = (saved.gain, saved.promised);
        if !saved.support_values.is_empty() {
            self.find_supports(problem, &saved.support_values);
        }
        self.move_to(problem, &saved.values)
    }

    /// Returns where the model that is kept was made, if one is.
    pub(crate) fn origin(&self) -> Option<&Origin> {
        Some(&self.kept.as_ref()?.origin)
    }

    /// Returns the cost where the search is.
    pub(crate) fn cost(&self) -> f64 {
        self.kept.as_ref().map_or(self.model.cost(), |kept| kept.cost)
    }

    /// Returns the predicted decrease below which the search ends.
    fn least_decrease(&self) -> f64 {
        self.options.decrease_below * self.model.observation_cost / self.degrees_of_freedom as f64
    }

    /// Takes one step along the kept model, or returns `None` if it serves no more.
    fn step_along(
        &mut self,
        problem: &Problem<'_>,
        values: &mut Vec<f64>,
        mut kept: KeptModel,
    ) -> Option<Result<f64, Stop>> {
        if self.options.cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed)) {
            self.kept = Some(kept);
            return Some(Err(Stop::Cancelled));
        }
        let below = self.least_decrease();
        let Self { structure, model, threads, steps, .. } = self;
        let mut step = Vec::new();
        let predicted = kept.step(problem, structure, model, threads, steps, &mut step);
        // What is lost in the cost's rounding cannot be tried, but is as good as the steps before it.
        let lost = ROUNDING * kept.cost;
        let untried = below.max(lost);
        if predicted <= 0.0 || !self.try_along(problem, values, &mut kept, (&step, predicted), untried) {
            return None;
        }
        self.kept = Some(kept);
        Some(match predicted {
            predicted if predicted <= below => Err(Stop::PredictedDecrease { predicted, below }),
            predicted if predicted <= lost => Err(Stop::Rounding { predicted, below: lost }),
            predicted => Ok(predicted),
        })
    }

    /// Takes a step if it leads to as good a point as `predicted`; one that should bring no more than
    /// `untried` is taken unseen.
    fn try_along(
        &mut self,
        problem: &Problem<'_>,
        values: &mut Vec<f64>,
        kept: &mut KeptModel,
        (step, predicted): (&[f64], f64),
        untried: f64,
    ) -> bool {
        let Self { structure, threads, gradient, trial_values, .. } = self;
        problem.parameters.retract(values, step, trial_values);
        if predicted > untried {
            self.counters.evaluations += 1;
            if !gradient.evaluate(problem, structure, trial_values, threads)
                || !kept.accept(step, predicted, gradient.cost, &gradient.entries)
            {
                return false;
            }
        }
        std::mem::swap(values, trial_values);
        true
    }

    /// Takes one step, trying shorter ones until the cost falls, or finds why there is none.
    fn step(&mut self, problem: &Problem<'_>, values: &mut Vec<f64>) -> Result<f64, Stop> {
        if let Some(kept) = self.kept.take() {
            if !kept.is_full() {
                if let Some(outcome) = self.step_along(problem, values, kept) {
                    return outcome;
                }
                self.counters.rejected_steps += 1;
                self.gain = 0.0;
            }
            // Where the gradient is defined, so is the model.
            if self.move_to(problem, values).is_err() {
                return Err(Stop::NoStep { damping: self.damping, above: MOST_DAMPING });
            }
        }
        let below = self.least_decrease();
        let Self { structure, threads, model, trial, steps, gradient, trial_values, .. } = self;
        let cost = model.cost();
        let rms = (cost / self.n_rows.max(1) as f64).sqrt();
        if rms < EXACT_RMS {
            return Err(Stop::Exact { rms, below: EXACT_RMS });
        }
        loop {
            if self.options.cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed)) {
                return Err(Stop::Cancelled);
            }
            if self.damping > MOST_DAMPING {
                return Err(Stop::NoStep { damping: self.damping, above: MOST_DAMPING });
            }
            self.counters.factorizations += 1;
            if steps.factor(structure, model, self.damping, threads) {
                steps.solve(problem, structure, model, self.damping, threads);
                let predicted = steps.predicted_decrease;
                problem.parameters.retract(values, &steps.step, trial_values);
                // A heavily damped step predicts little without being near the optimum.
                if predicted <= below && self.damping <= 1.0 {
                    std::mem::swap(values, trial_values);
                    return Err(Stop::PredictedDecrease { predicted, below });
                }
                self.counters.evaluations += 1;
                let promised = std::mem::replace(&mut self.promised, predicted);
                let is_slow = self.options.slow_end == SlowEnd::Learn
                    && self.gain > SLOW_GAIN
                    && predicted > SLOW_SHARE * promised;
                let is_cheaper = structure.is_worth_keeping() && self.gain > KEEP_GAIN;
                if predicted <= KEEP_BELOW * cost && (is_slow || is_cheaper) {
                    let origin =
                        Origin { values: values.clone(), iterations: self.counters.iterations, promised };
                    let mut kept = KeptModel::new(structure, model, origin);
                    if gradient.evaluate(problem, structure, trial_values, threads)
                        && kept.accept(&steps.step, predicted, gradient.cost, &gradient.entries)
                    {
                        std::mem::swap(values, trial_values);
                        self.kept = Some(kept);
                        return Ok(predicted);
                    }
                    self.counters.evaluations += 1;
                }
                let outcome = trial.evaluate(problem, structure, trial_values, threads);
                // Where terms leave their support, another structure fits.
                let other = (outcome == Err(Failure::OutsideSupport)).then(|| {
                    let other = Structure::new(problem, trial_values);
                    let mut model = Linearization::new(&other);
                    let outcome = model.evaluate(problem, &other, trial_values, threads);
                    (other, model, outcome)
                });
                let trial_cost = match &other {
                    None => outcome.map(|()| trial.cost()),
                    Some((_, model, outcome)) => outcome.map(|()| model.cost()),
                };
                if let Ok(trial_cost) = trial_cost {
                    let decrease = cost - trial_cost;
                    if decrease > 0.0 {
                        let gain = decrease / predicted;
                        let shrink = (1.0 - (2.0 * gain - 1.0).powi(3)).max(LEAST_SHRINK);
                        self.damping = (self.damping * shrink).max(LEAST_DAMPING);
                        self.growth = 2.0;
                        self.gain = gain;
                        match other {
                            None => std::mem::swap(model, trial),
                            Some((other, other_model, _)) => {
                                *trial = Linearization::new(&other);
                                *steps = StepSolver::new(&other);
                                (*structure, *model) = (other, other_model);
                                self.support_values = trial_values.clone();
                            }
                        }
                        std::mem::swap(values, trial_values);
                        return Ok(predicted);
                    }
                    if predicted <= ROUNDING * cost {
                        return Err(Stop::Rounding { predicted, below: ROUNDING * cost });
                    }
                }
            }
            self.counters.rejected_steps += 1;
            self.damping *= self.growth;
            self.growth *= 2.0;
        }
    }
}

impl<'p> Solver<&'p Problem<'p>, State> for LevenbergMarquardt<'_> {
    fn name(&self) -> &str {
        "Levenberg-Marquardt"
    }

    fn next_iter(
        &mut self,
        problem: &mut argmin::core::Problem<&'p Problem<'p>>,
        mut state: State,
    ) -> Result<(State, Option<KV>), argmin::core::Error> {
        let problem =
            problem.problem.as_ref().ok_or_else(|| argmin::core::Error::msg("the problem is gone"))?;
        let mut values =
            state.take_param().ok_or_else(|| argmin::core::Error::msg("the state has no values"))?;
        let outcome = self.step(problem, &mut values);
        let cost = self.cost();
        let (taken, cost) = match outcome {
            Ok(predicted) => (Some(predicted), cost),
            // The last step is taken without another evaluation; the model says where it leads.
            Err(Stop::PredictedDecrease { predicted, .. }) => (Some(predicted), cost - predicted),
            Err(_) => (None, cost),
        };
        let kv = taken.map(|predicted| {
            self.counters.iterations += 1;
            kv!("damping" => self.damping; "predicted_decrease" => predicted;)
        });
        let state = state.param(values).cost(cost);
        let Err(stop) = outcome else { return Ok((state, kv)) };
        let reason = match stop {
            Stop::Cancelled => TerminationReason::Interrupt,
            _ if stop.is_converged() => TerminationReason::SolverConverged,
            _ => TerminationReason::SolverExit(stop.to_string()),
        };
        self.stop = Some(stop);
        Ok((state.terminate_with(reason), kv))
    }
}
