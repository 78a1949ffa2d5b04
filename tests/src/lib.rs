//! What end-to-end tests, golden tests and benches share: readers of the conformance data.
//!
//! Architecture invariant: nothing that ships depends on this package.

pub mod conformance;
pub mod mrcal_problem;
pub mod npz;
pub mod opencv_sets;
