//! Judgement: how far two cameras differ, and what is wrong with a calibration.
//!
//! [`compare`] maps the difference of two lenses over the image, after the rotation or pose that
//! the lenses themselves imply; [`compare_rigs`] does so for cameras of the same name and adds the
//! rig's geometry. [`findings`] notices what is doubtful about a calibration, each with a code, a
//! number, a limit and a fix; [`verdict`] sums them up; [`explain`] is the long text of a code.
//!
//! [`ProjectionUncertainty`] is how well a camera's projections are known, over the image and with
//! distance, and [`stereo_uncertainty`] how well two cameras measure distance.
//!
//! A finding is a plug: one file in `findings/` and one line in `findings/registry.rs`.
//!
//! Architecture invariant: nothing here solves for a calibration or changes one.

mod compare;
mod error;
mod findings;
mod looks;
mod slopes;
mod statistics;
mod uncertainty;
mod verdict;

pub use compare::{
    CameraComparison, CompareOptions, ComparedCamera, Comparison, PairDifference, PoseSignificance,
    RigComparison, Significance, TransferDifference, compare, compare_known_rigs, compare_rigs,
};
pub use error::Error;
pub use findings::{codes, explain, findings, findings_before};
pub use looks::{CameraLook, Looks, WeakestLink, looks};
pub use uncertainty::{
    AtDistance, Method, ProjectionUncertainty, Propagation, Spread, StereoUncertainty, UncertaintyMap,
    stereo_uncertainty,
};
pub use verdict::{Verdict, verdict};
