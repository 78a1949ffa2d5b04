//! Target points in one grey image, labelled and with a sigma each.
//!
//! [`detect`] asks the detector of the target's kind. It returns points only where what is seen leaves one labelling:
//! a label that might be wrong is not given, and the reason is returned instead.
//!
//! Architecture invariant: nothing here knows a lens, a pose of a camera, or a file.

mod april_grid;
mod blobs;
mod charuco;
mod chessboard;
mod circles;
mod detection;
mod fit;
mod grid;
mod labelled;
mod lanes;
mod lattice;
mod local_map;
mod marker;
mod placement;
mod plane;
mod registry;
mod saddles;
mod statistics;
mod votes;

pub use detection::{Detection, Missed, Pattern};
pub use registry::{DETECTORS, DETECTORS_REVISION, Detector, detect};
