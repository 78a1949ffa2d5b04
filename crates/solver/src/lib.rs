//! Sparse Levenberg-Marquardt on manifolds, and the covariance at the optimum.
//!
//! A [`Problem`] is parameter blocks and [`Term`]s. A term reports `[J r]ᵀ [J r]` over its blocks;
//! J itself is never formed. Blocks marked [`Elimination::First`] are eliminated by their Schur
//! complement, the rest is factored by faer. Results do not depend on the number of threads.
//!
//! Architecture invariant: the solver does not know what a camera is.

mod aligned;
mod checkpoint;
mod composite;
mod covariance;
mod error;
mod gradient;
pub mod gram;
mod kept_model;
pub mod lanes;
mod levenberg_marquardt;
mod linearization;
mod local;
mod options;
mod ordering;
mod pattern;
mod prior;
mod problem;
mod reduced;
mod scatter;
mod solve;
mod sparse;
mod sparse_prior;
mod step;
mod stop;
mod structure;
mod substitution;
mod threads;

pub use aligned::Aligned;
pub use composite::{
    CompositeColumns, CompositeTerm, LinkMap, Links, MAX_LINKS, Weighed, expand_composite,
    linearize_composite,
};
pub use covariance::{Covariance, LinearFunctions, covariance};
pub use error::Error;
pub use levenberg_marquardt::Counters;
pub use local::{Accumulated, EliminatedSums, LocalTerm};
pub use options::{Checkpointing, Observer, Progress, SlowEnd, SolveOptions};
pub use prior::{JointBelief, JointPrior, PosePrior, VectorPrior};
pub use problem::{BlockId, Elimination, GramMut, Parameters, Problem, Scratch, Term, TermKind, Values};
pub use pulp;
pub use solve::{Solution, solve, solve_observed};
pub use sparse_prior::{Belief, SparsePrior};
pub use stop::Stop;
pub use threads::Threads;
