//! The registry of detectors: one line each.

use boresight_data::{Geometry, GrayImage, Target};

use crate::detection::{Detection, Missed};
use crate::{april_grid, charuco, chessboard, circles};

/// A detector of one kind of target.
pub struct Detector {
    /// The kind of target, as it is written on the command line.
    pub name: &'static str,
    /// Tells whether it detects targets of this geometry.
    pub(crate) handles: fn(&Geometry) -> bool,
    /// Detects a target that it handles.
    pub(crate) detect: fn(&GrayImage, &Target) -> Detection,
}

/// All detectors.
pub const DETECTORS: &[Detector] = &[
    Detector { name: "chessboard", handles: chessboard::handles, detect: chessboard::detect },
    Detector { name: "charuco", handles: charuco::handles, detect: charuco::detect },
    Detector { name: "aprilgrid", handles: april_grid::handles, detect: april_grid::detect },
    Detector { name: "circles", handles: circles::handles, detect: circles::detect },
];

/// Counts up whenever a detector sees other points than before in the same image, so that nothing old is remembered.
pub const DETECTORS_REVISION: u32 = 4;

/// Detects the points of a target in an image: whole or in part, or not at all, with the reason.
pub fn detect(image: &GrayImage, target: &Target) -> Detection {
    match DETECTORS.iter().find(|detector| (detector.handles)(&target.geometry)) {
        Some(detector) => (detector.detect)(image, target),
        None => Detection::missed(Missed::NoDetector),
    }
}
