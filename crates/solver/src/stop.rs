//! Why a search stopped, with the evidence.

use std::fmt;

/// Why a search stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Stop {
    /// The model promises next to nothing: the optimum is reached.
    PredictedDecrease {
        /// The decrease of the cost that the last step, which was taken, was predicted to bring.
        predicted: f64,
        /// The limit.
        below: f64,
    },
    /// All residuals vanish: the data are met exactly.
    Exact {
        /// The root mean square residual, in sigmas.
        rms: f64,
        /// The limit.
        below: f64,
    },
    /// What could still be gained is lost in the rounding of the cost.
    Rounding {
        /// The decrease that was predicted.
        predicted: f64,
        /// The limit.
        below: f64,
    },
    /// No step lowers the cost, however short.
    NoStep {
        /// The damping reached.
        damping: f64,
        /// The limit.
        above: f64,
    },
    /// The iterations allowed are used up.
    Iterations {
        /// Their number.
        count: usize,
    },
    /// The time allowed is used up.
    TimeLimit {
        /// The time allowed, in seconds.
        seconds: f64,
    },
    /// The caller asked to stop.
    Cancelled,
    /// The search never began; for callers that found nothing to solve.
    NotStarted,
}

impl Stop {
    /// Tells whether the stop means that an optimum was reached.
    pub fn is_converged(&self) -> bool {
        matches!(self, Stop::PredictedDecrease { .. } | Stop::Exact { .. } | Stop::Rounding { .. })
    }

    /// Tells whether the search stopped at a limit of its caller's, from where it could go on.
    pub(crate) fn is_interruption(&self) -> bool {
        matches!(self, Stop::Iterations { .. } | Stop::TimeLimit { .. } | Stop::Cancelled)
    }
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Stop::PredictedDecrease { predicted, below } => {
                write!(f, "converged: predicted decrease {predicted:.1e} is below {below:.1e}")
            }
            Stop::Exact { rms, below } => {
                write!(f, "converged: residuals of {rms:.1e} sigma are below {below:.1e}")
            }
            Stop::Rounding { predicted, below } => {
                write!(
                    f,
                    "converged: predicted decrease {predicted:.1e} is lost in the cost's rounding, {below:.1e}"
                )
            }
            Stop::NoStep { damping, above } => {
                write!(
                    f,
                    "not converged: no step lowers the cost at damping {damping:.1e}, above {above:.1e}"
                )
            }
            Stop::Iterations { count } => write!(f, "not converged: all {count} iterations are used up"),
            Stop::TimeLimit { seconds } => {
                write!(f, "not converged: the time limit of {seconds} s is used up")
            }
            Stop::Cancelled => write!(f, "not converged: cancelled"),
            Stop::NotStarted => write!(f, "not converged: never started"),
        }
    }
}
