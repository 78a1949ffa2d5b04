//! Adjusts a scene to a dataset: passes of solving and judging until the set of outliers stands.

use std::collections::BTreeMap;

use boresight_data::{Calibration, Dataset, Scene, SolveRecord};
use boresight_solver::{SlowEnd, Solution, SolveOptions, Term as _, solve_observed};

use crate::error::Error;
use crate::options::{AdjustOptions, Loss, Observer, Rejection};
use crate::rejection::Lengths;
use crate::report::{Outcome, report};
use crate::rig_problem::RigProblem;
use crate::stand_in::nearer_seed;
use crate::suspects::{leave_out, suspects};

/// Passes after which observations are judged again stop at a predicted decrease below this share of the cost, as the
/// last step is taken all the same: the first comes from far, the others need only be near enough to judge by.
const ROUGH_SHARES: [f64; 2] = [1e-1, 1e-2];

/// Cauchy's c of the robust pass, in robust sigmas: 95 % efficient on Gaussian residuals.
const ROBUST_LOSS_SIGMAS: f64 = 2.385;

/// Where views are judged as a whole, the robust passes stop at this predicted decrease, in residual variances.
const ROBUST_DECREASE_BELOW: f64 = 1e-2;

/// Rounds in which views are judged as a whole, after a first look; the worst can hide others from the first.
const MAX_SUSPECT_ROUNDS: usize = 4;

/// Passes after which the set of outliers is taken as it is; it settles in two or three.
const MAX_PASSES: usize = 12;

/// The first damping from a seed, which closed forms bring nearer than a solver may expect.
const SEED_DAMPING: f64 = 1e-5;

/// The first damping where poses are nearly right: the surface of a lens is then all but linear.
const NEARER_DAMPING: f64 = 1e-8;

/// The first damping where all is nearly right: the long valleys of rational lenses are walked along rather than down into.
const WARM_DAMPING: f64 = 1e-10;

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
    let (rig, outcome) = settled(dataset, seed, options, observer)?;
    report(dataset, seed, &rig, outcome, options)
}

/// Where an adjustment settled, without a report.
#[derive(Clone, Debug)]
pub struct Settled {
    /// The scene there.
    pub scene: Scene,
    /// The sum of squares, priors included.
    pub cost: f64,
    /// The observations that are not used, each as its view and its place there; all those of a view that is left out.
    pub rejected: Vec<(usize, usize)>,
    /// The views that were left out as a whole, each with the reason.
    pub left_out: BTreeMap<usize, String>,
    /// How the search went.
    pub solve: SolveRecord,
}

/// Solves and judges outliers as [`adjust`] does, without covariance or report.
pub fn settle(dataset: &Dataset, seed: &Scene, options: &AdjustOptions) -> Result<Settled, Error> {
    let (rig, outcome) = settled(dataset, seed, options, None)?;
    let mut rejected = Vec::new();
    for (term_idx, (view_idx, _)) in rig.views.iter().enumerate() {
        let kept = outcome.kept.as_ref().map(|kept| &kept[term_idx]);
        let places = 0..dataset.views[*view_idx].observations.len();
        rejected.extend(places.filter(|&i| kept.is_some_and(|kept| !kept[i])).map(|i| (*view_idx, i)));
    }
    for view_idx in outcome.left_out.keys() {
        rejected.extend((0..dataset.views[*view_idx].observations.len()).map(|i| (*view_idx, i)));
    }
    rejected.sort_unstable();
    let scene = rig.scene(dataset, seed, rig.parameters.values());
    let solve = outcome.record(outcome.cost);
    Ok(Settled { scene, cost: outcome.cost, rejected, left_out: outcome.left_out, solve })
}

/// Solves and judges until the set of outliers stands.
fn settled(
    dataset: &Dataset,
    seed: &Scene,
    options: &AdjustOptions,
    observer: Option<Observer>,
) -> Result<(RigProblem, Outcome), Error> {
    let mut rig = RigProblem::new(dataset, seed, options)?;
    let mut passes = Passes { dataset, options, observer, outcome: Outcome::default() };
    match options.rejection {
        Rejection::None => {
            rig.views.iter_mut().for_each(|(_, term)| term.set_loss(options.loss));
            let exact = long_solve_options(options);
            passes.solve(&mut rig, &SolveOptions { slow_end: SlowEnd::Learn, ..exact })?;
        }
        Rejection::Beyond { sigmas } => {
            let lengths = lengths(dataset, &rig);
            let lengths = passes.solve_robustly(&mut rig, lengths, Effort::Rough)?;
            let lengths = passes.leave_out_suspects(&mut rig, lengths, sigmas)?;
            passes.reject_until_settled(&mut rig, lengths, sigmas)?;
        }
    }
    Ok((rig, passes.outcome))
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
    let mut solve_options = long_solve_options(options);
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

/// How near a robust pass comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Effort {
    /// Near enough to tell single outliers, most of which are far off.
    Rough,
    /// Near enough to tell views.
    Fine,
}

/// What goes on from pass to pass.
struct Passes<'a> {
    dataset: &'a Dataset,
    options: &'a AdjustOptions,
    observer: Option<Observer>,
    outcome: Outcome,
}

impl Passes<'_> {
    /// Comes near the optimum with a loss that outliers cannot bend, from where residuals have these lengths, and
    /// returns their lengths there.
    fn solve_robustly(
        &mut self,
        rig: &mut RigProblem,
        mut now: Lengths,
        effort: Effort,
    ) -> Result<Lengths, Error> {
        // The seed's residuals are far larger than the noise; twice the loss narrows down on it.
        for (pass, share) in ROUGH_SHARES.into_iter().enumerate() {
            let scales = now.scales(self.dataset);
            for (view_idx, term) in &mut rig.views {
                let scale = scales[self.dataset.views[*view_idx].camera.0 as usize];
                term.set_loss(Loss::Cauchy { sigmas: (ROBUST_LOSS_SIGMAS * scale).max(1e-9) });
            }
            let mut options = match effort {
                Effort::Rough => self.rough(rig, share),
                Effort::Fine => solve_options(self.options, ROBUST_DECREASE_BELOW),
            };
            if pass == 0 {
                options.first_damping = SEED_DAMPING;
            }
            self.solve(rig, &options)?;
            now = lengths(self.dataset, rig);
        }
        Ok(now)
    }

    /// Leaves out the views that do not go with the others, and comes near the optimum again without them.
    fn leave_out_suspects(
        &mut self,
        rig: &mut RigProblem,
        mut now: Lengths,
        sigmas: f64,
    ) -> Result<Lengths, Error> {
        for round in 0..MAX_SUSPECT_ROUNDS {
            let reasons = suspects(self.dataset, rig, &now, &now.scales(self.dataset), sigmas);
            if reasons.is_empty() {
                break;
            }
            // Which of several views is to blame is told at the robust optimum alone.
            if round == 0 {
                now = self.solve_robustly(rig, now, Effort::Fine)?;
                continue;
            }
            leave_out(rig, self.dataset, &reasons);
            self.outcome.left_out.extend(reasons);
            let without = lengths(self.dataset, rig);
            now = self.solve_robustly(rig, without, Effort::Fine)?;
        }
        Ok(now)
    }

    /// Solves and judges until no observation is rejected or taken back any more.
    fn reject_until_settled(
        &mut self,
        rig: &mut RigProblem,
        mut now: Lengths,
        sigmas: f64,
    ) -> Result<(), Error> {
        rig.views.iter_mut().for_each(|(_, term)| term.set_loss(self.options.loss));
        let [_, share] = ROUGH_SHARES;
        let rough = self.rough(rig, share);
        let mut kept: Option<Vec<Vec<bool>>> = None;
        let mut is_exact = false;
        for pass in 0..MAX_PASSES {
            let scales = now.scales(self.dataset);
            let judged = now.kept(self.dataset, &scales, sigmas);
            let stands = kept.as_ref() == Some(&judged);
            if stands && is_exact {
                self.outcome.settled = true;
                break;
            }
            if !stands {
                for ((view_idx, term), kept) in rig.views.iter_mut().zip(&judged) {
                    term.set_kept(&self.dataset.views[*view_idx].observations, |idx| kept[idx]);
                }
                self.outcome.limits_sigmas = scales.iter().map(|scale| sigmas * scale).collect();
                kept = Some(judged);
            }
            // What is judged again need not be exact before it stands.
            let is_first_exact = !is_exact && (stands || pass + 1 == MAX_PASSES);
            is_exact |= is_first_exact;
            if is_exact {
                // The first is the long one; those after it are other problems, which its file must not be read for.
                let exact = if is_first_exact {
                    long_solve_options(self.options)
                } else {
                    solve_options(self.options, self.options.decrease_below)
                };
                let slow_end = SlowEnd::Learn;
                self.solve(rig, &SolveOptions { first_damping: WARM_DAMPING, slow_end, ..exact })?;
            } else {
                self.solve(rig, &rough)?;
            }
            if !self.outcome.stop.is_some_and(|stop| stop.is_converged()) {
                break;
            }
            now = lengths(self.dataset, rig);
        }
        self.outcome.kept = kept;
        Ok(())
    }

    /// Returns the options of a solve that another will follow.
    fn rough(&self, rig: &RigProblem, share: f64) -> SolveOptions {
        // In residual variances, of which there are as many as rows.
        let n_rows: usize = rig.views.iter().map(|(_, term)| term.row_count()).sum();
        let options = solve_options(self.options, share * n_rows as f64);
        SolveOptions { first_damping: WARM_DAMPING, ..options }
    }

    /// Solves once and moves the rig's values to the solution.
    fn solve(&mut self, rig: &mut RigProblem, options: &SolveOptions) -> Result<(), Error> {
        let solution = {
            let problem = rig.problem()?;
            solve_observed(&problem, options, self.observer.clone()).map_err(|error| named(error, rig))?
        };
        self.outcome.add(&solution);
        rig.parameters.set_values(&solution.values);
        Ok(())
    }
}

/// Returns the options of the one solve of an adjustment that is long enough to be worth a checkpoint.
fn long_solve_options(options: &AdjustOptions) -> SolveOptions {
    let checkpoint = options.checkpoint.clone();
    SolveOptions { checkpoint, ..solve_options(options, options.decrease_below) }
}

/// Returns the options of a solve without a checkpoint.
pub(crate) fn solve_options(options: &AdjustOptions, decrease_below: f64) -> SolveOptions {
    SolveOptions {
        decrease_below,
        max_iterations: options.max_iterations,
        first_damping: SEED_DAMPING,
        threads: options.threads,
        time_limit: options.time_limit,
        cancel: options.cancel.clone(),
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
        (*view_idx, term.lengths(rig.parameters.values(), observations))
    });
    Lengths { views: views.collect() }
}
