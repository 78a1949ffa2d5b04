//! The registry of detectors: one line each.

use boresight_data::{Geometry, GrayImage, Observation, Target};

use crate::detection::{Detection, Missed};
use crate::statistics::median;
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
pub const DETECTORS_REVISION: u32 = 6;

/// No point is believed to be known better than this share of the sigma of the image's middle one.
const LEAST_SIGMA_SHARE: f64 = 0.5;

/// Detects the points of a target in an image: whole or in part, or not at all, with the reason.
pub fn detect(image: &GrayImage, target: &Target) -> Detection {
    let Some(detector) = DETECTORS.iter().find(|detector| (detector.handles)(&target.geometry)) else {
        return Detection::missed(Missed::NoDetector);
    };
    let mut found = (detector.detect)(image, target);
    hold_least_sigmas(&mut found.observations);
    found
}

/// Raises sigmas that are far below those of the other points of an image.
///
/// The grey values around one point say by chance or for want of structure that it is known much better than all others;
/// weighed by that, it would outweigh them. What is known of the image as a whole bounds it: a point has at most four
/// times the weight of the middle one.
fn hold_least_sigmas(observations: &mut [Observation]) {
    let Some(middle_px) = median(observations.iter().map(|observation| observation.sigma_px)) else { return };
    for observation in observations {
        observation.sigma_px = observation.sigma_px.max(LEAST_SIGMA_SHARE * middle_px);
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::PointId;

    use super::*;

    #[test]
    fn one_point_does_not_outweigh_all_others() {
        let observation = |sigma_px| Observation { point: PointId(0), pixel: [0.0; 2], sigma_px };
        let mut observations = [0.02, 0.0001, 0.03, 0.012, 0.5].map(observation);
        hold_least_sigmas(&mut observations);
        let sigmas_px = observations.map(|observation| observation.sigma_px);
        assert_eq!(sigmas_px, [0.02, 0.01, 0.03, 0.012, 0.5]);
        hold_least_sigmas(&mut []);
    }
}
