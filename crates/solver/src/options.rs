//! What a caller may ask of a solve.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// How to solve. Every default is meant to be left alone.
#[derive(Clone, Debug)]
pub struct SolveOptions {
    /// Stop when the model predicts a decrease of the cost below this many times the variance of a
    /// residual (cost per degree of freedom). The last step is still taken.
    pub decrease_below: f64,
    /// Stop after this many iterations, those before a resume included.
    pub max_iterations: usize,
    /// The number of threads; 0 takes one for each core. The result does not depend on it.
    pub threads: usize,
    /// The first damping, relative to the diagonal.
    pub first_damping: f64,
    /// What is done where steps become short slowly, as in the valleys of nearly redundant parameters.
    pub slow_end: SlowEnd,
    /// Stop after the first iteration that ends past this much time; `None` sets no limit.
    pub time_limit: Option<Duration>,
    /// Stop when this becomes true, for example by Ctrl-C; `None` cannot be stopped.
    pub cancel: Option<Arc<AtomicBool>>,
    /// Write the state of the search here now and then and when it is stopped by a limit, and resume
    /// from it; `None` does neither. A file that is left when the search ends is the caller's to delete.
    pub checkpoint: Option<Checkpointing>,
}

/// Where and how often the state of a search is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpointing {
    /// The file. It is bound to the problem by a hash, and replaced as a whole.
    pub path: PathBuf,
    /// After how many iterations it is written anew; 0 writes it only at the start and at a limit.
    pub every: u64,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self {
            decrease_below: 1e-6,
            max_iterations: 100,
            threads: 0,
            first_damping: 1e-3,
            slow_end: SlowEnd::Persist,
            time_limit: None,
            cancel: None,
            checkpoint: None,
        }
    }
}

/// What is done where steps become short slowly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SlowEnd {
    /// Nothing.
    #[default]
    Persist,
    /// What Gauss and Newton leave out is learnt from gradients, along a model that is kept.
    Learn,
}

/// How far a search has come; what a progress bar shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The iteration, counted from one.
    pub iteration: usize,
    /// The cost after it.
    pub cost: f64,
    /// The decrease that the model predicted for its step.
    pub predicted_decrease: f64,
    /// The damping of the next step.
    pub damping: f64,
}

/// Who hears of each iteration that takes a step. It is called from the thread that solves.
pub type Observer = Arc<dyn Fn(Progress) + Send + Sync>;
