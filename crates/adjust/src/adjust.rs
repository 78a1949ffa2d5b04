//! Adjusts a scene to a dataset: passes of solving and judging until the set of outliers stands.

use boresight_data::{Calibration, Dataset, Scene};
use boresight_solver::{Solution, SolveOptions, solve_observed};

use crate::error::Error;
use crate::options::{AdjustOptions, Loss, Observer, Rejection};
use crate::rejection::Lengths;
use crate::report::{Outcome, report};
use crate::rig_problem::RigProblem;
use crate::stand_in::nearer_seed;
use crate::suspects::{leave_out, suspects};

/// The robust pass stops early: it only has to come near enough to tell outliers.
const ROBUST_DECREASE_BELOW: f64 = 1e-2;

/// Cauchy's c of the robust pass, in robust sigmas: 95 % efficient on Gaussian residuals.
const ROBUST_LOSS_SIGMAS: f64 = 2.385;

/// Rounds in which views are left out as a whole; the worst can hide others from the first.
const MAX_SUSPECT_ROUNDS: usize = 3;

/// Passes after which the set of outliers is taken as it is; it settles in two or three.
const MAX_PASSES: usize = 12;

/// The first damping where poses are nearly right: the surface of a lens is then all but linear.
const NEARER_DAMPING: f64 = 1e-8;

/// Returns the calibration that explains `dataset` best, starting from `seed`.
///
/// Views whose camera or frame the seed does not know take no part and are reported as left out.
/// Not converging is no error; the calibration's solve record tells.
pub fn adjust(
    dataset: &Dataset,
    seed: &Scene,
    options: &AdjustOptions,
    observer: Option<Observer>,
) -> Result<Calibration, Error> {
    let mut rig = RigProblem::new(dataset, seed, options)?;
    let mut passes = Passes { dataset, options, observer, outcome: Outcome::default() };
    match options.rejection {
        Rejection::None => {
            rig.views.iter_mut().for_each(|(_, term)| term.set_loss(options.loss));
            passes.solve(&mut rig, options.decrease_below, true)?;
        }
        Rejection::Beyond { sigmas } => {
            passes.solve_robustly(&mut rig)?;
            passes.leave_out_suspects(&mut rig, sigmas)?;
            passes.reject_until_settled(&mut rig, sigmas)?;
        }
    }
    report(dataset, seed, &rig, passes.outcome, options)
}

/// Where a single solve ended.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// The scene there.
    pub scene: Scene,
    /// The solver's own account.
    pub solution: Solution,
}

/// Solves once, with all observations and without covariance: the least that an adjustment can be.
pub fn optimize(dataset: &Dataset, seed: &Scene, options: &AdjustOptions) -> Result<Optimum, Error> {
    let nearer = nearer_seed(dataset, seed, options);
    let seed = nearer.as_ref().map_or(seed, |nearer| &nearer.scene);
    let mut rig = RigProblem::new(dataset, seed, options)?;
    rig.views.iter_mut().for_each(|(_, term)| term.set_loss(options.loss));
    let problem = rig.problem()?;
    let mut solve_options = solve_options(options, options.decrease_below, true);
    if nearer.is_some() {
        solve_options.first_damping = NEARER_DAMPING;
    }
    let mut solution =
        boresight_solver::solve(&problem, &solve_options).map_err(|error| named(error, &rig))?;
    if let Some(nearer) = &nearer {
        solution.counters.iterations += nearer.counters.iterations;
        solution.counters.evaluations += nearer.counters.evaluations;
        solution.counters.factorizations += nearer.counters.factorizations;
        solution.counters.rejected_steps += nearer.counters.rejected_steps;
    }
    let scene = rig.scene(dataset, seed, solution.values(&problem));
    Ok(Optimum { scene, solution })
}

/// What goes on from pass to pass.
struct Passes<'a> {
    dataset: &'a Dataset,
    options: &'a AdjustOptions,
    observer: Option<Observer>,
    outcome: Outcome,
}

impl Passes<'_> {
    /// Comes near the optimum with a loss that outliers cannot bend.
    fn solve_robustly(&mut self, rig: &mut RigProblem) -> Result<(), Error> {
        // The seed's residuals are far larger than the noise; twice the loss narrows down on it.
        for _ in 0..2 {
            let scales = lengths(self.dataset, rig).scales(self.dataset);
            for (view_idx, term) in &mut rig.views {
                let scale = scales[self.dataset.views[*view_idx].camera.0 as usize];
                term.set_loss(Loss::Cauchy { sigmas: (ROBUST_LOSS_SIGMAS * scale).max(1e-9) });
            }
            self.solve(rig, ROBUST_DECREASE_BELOW, false)?;
        }
        Ok(())
    }

    /// Leaves out the views that do not go with the others, and comes near the optimum again without them.
    fn leave_out_suspects(&mut self, rig: &mut RigProblem, sigmas: f64) -> Result<(), Error> {
        for _ in 0..MAX_SUSPECT_ROUNDS {
            let lengths = lengths(self.dataset, rig);
            let scales = lengths.scales(self.dataset);
            let reasons = suspects(self.dataset, rig, &lengths, &scales, sigmas);
            if reasons.is_empty() {
                break;
            }
            leave_out(rig, self.dataset, &reasons);
            self.outcome.left_out.extend(reasons);
            self.solve_robustly(rig)?;
        }
        Ok(())
    }

    /// Solves and judges until no observation is rejected or taken back any more.
    fn reject_until_settled(&mut self, rig: &mut RigProblem, sigmas: f64) -> Result<(), Error> {
        rig.views.iter_mut().for_each(|(_, term)| term.set_loss(self.options.loss));
        let mut kept: Option<Vec<Vec<bool>>> = None;
        for pass in 0..MAX_PASSES {
            let lengths = lengths(self.dataset, rig);
            let scales = lengths.scales(self.dataset);
            let now = lengths.kept(self.dataset, &scales, sigmas);
            if kept.as_ref() == Some(&now) {
                self.outcome.settled = true;
                break;
            }
            for ((view_idx, term), kept) in rig.views.iter_mut().zip(&now) {
                term.set_kept(&self.dataset.views[*view_idx].observations, |idx| kept[idx]);
            }
            self.outcome.limits_sigmas = scales.iter().map(|scale| sigmas * scale).collect();
            kept = Some(now);
            self.solve(rig, self.options.decrease_below, pass + 1 == MAX_PASSES)?;
            if !self.outcome.stop.is_some_and(|stop| stop.is_converged()) {
                break;
            }
        }
        self.outcome.kept = kept;
        Ok(())
    }

    /// Solves once and moves the rig's values to the solution.
    fn solve(&mut self, rig: &mut RigProblem, decrease_below: f64, is_last: bool) -> Result<(), Error> {
        let options = solve_options(self.options, decrease_below, is_last);
        let solution = {
            let problem = rig.problem()?;
            solve_observed(&problem, &options, self.observer.clone()).map_err(|error| named(error, rig))?
        };
        self.outcome.add(&solution);
        rig.parameters.set_values(&solution.values);
        Ok(())
    }
}

/// Returns the options of one solve; only the last pass is worth a checkpoint.
pub(crate) fn solve_options(options: &AdjustOptions, decrease_below: f64, is_last: bool) -> SolveOptions {
    SolveOptions {
        decrease_below,
        max_iterations: options.max_iterations,
        threads: options.threads,
        time_limit: options.time_limit,
        cancel: options.cancel.clone(),
        checkpoint: options.checkpoint.clone().filter(|_| is_last),
        ..SolveOptions::default()
    }
}

/// Says in a caller's words what the solver says in its own.
pub(crate) fn named(error: boresight_solver::Error, rig: &RigProblem) -> Error {
    match error {
        boresight_solver::Error::UndefinedStart { term_idx } => match rig.views.get(term_idx) {
            Some((view_idx, _)) => Error::SeedOutOfView { view_idx: *view_idx },
            None => error.into(),
        },
        boresight_solver::Error::TooFewRows { rows, unknowns } => Error::TooFewEquations { rows, unknowns },
        error => error.into(),
    }
}

/// Returns the lengths of all residuals at the rig's values, in sigmas.
fn lengths(dataset: &Dataset, rig: &RigProblem) -> Lengths {
    let views = rig.views.iter().map(|(view_idx, term)| {
        let observations = &dataset.views[*view_idx].observations;
        let predictions = term.predict(rig.parameters.values());
        let length = |(prediction, observation): (Option<[f64; 2]>, &boresight_data::Observation)| {
            prediction.map_or(f64::INFINITY, |[u, v]| {
                (u - observation.pixel[0]).hypot(v - observation.pixel[1]) / observation.sigma_px
            })
        };
        (*view_idx, predictions.into_iter().zip(observations).map(length).collect())
    });
    Lengths { views: views.collect() }
}
