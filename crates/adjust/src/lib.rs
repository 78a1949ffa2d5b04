//! From a dataset and a seed to a solver problem, and from its solution to a calibration.
//!
//! One residual block serves every topology: a view is a lens, a target shape and a chain of poses
//! from target to camera, and which of them are shared is data.
//!
//! Architecture invariant: nothing here knows how a dataset came about or what becomes of a calibration.

mod adjust;
mod chain;
mod error;
mod loose;
mod motions;
mod options;
mod rejection;
mod report;
mod reprojection;
mod rig_problem;

pub use adjust::{Optimum, adjust, optimize};
pub use chain::{Chain, Link};
pub use error::Error;
pub use options::{AdjustOptions, Hold, Loss, Observer, Progress, Regularization, Rejection};
pub use reprojection::{Layouts, Reprojection, TargetPoints};
