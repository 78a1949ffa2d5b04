//! Whether the robot's positions are to be corrected as a whole, and the answer for those who do not correct them.

use boresight_adjust::HeldOut;
use boresight_data::Stretch;
use boresight_geometry::Pose;
use serde::Serialize;

use super::MethodFigures;
use super::compare::mean;

/// The answer for positions as the robot says them, where another one, for corrected positions, foretells better.
#[derive(Clone, Debug, PartialEq)]
pub struct PlainAnswer {
    /// Its method, and how it foretells frames that were left out.
    pub method: MethodFigures,
    /// The rig's pose on the flange or in the base, whichever bears it.
    pub carrier_from_rig: Pose,
    /// The target's pose in the base or on the flange.
    pub other_from_target: Pose,
}

/// How positions are to be corrected, as `hand-eye.json` says it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct StretchDocument {
    how_to_use: &'static str,
    centre_in_base_m: [f64; 3],
    /// Row by row.
    matrix: [[f64; 3]; 3],
}

impl StretchDocument {
    pub(super) fn new(stretch: &Stretch) -> Self {
        Self {
            how_to_use: "`poses` hold for corrected positions of the flange: position_m + matrix * (position_m - \
                         centre_in_base_m), its rotation as it is. Without correcting, use `without_stretch`.",
            centre_in_base_m: stretch.centre_in_base.into(),
            matrix: [0, 1, 2].map(|row| [0, 1, 2].map(|column| stretch.matrix[(row, column)])),
        }
    }
}

/// A stretch with a sigma of less, in metres a metre, is none.
pub(super) const NEGLIGIBLE: f64 = 1e-6;

/// How many standard errors of the difference corrected positions must foretell better by: chance does in one of forty.
const STANDARD_ERRORS: f64 = 2.0;

/// Tells whether corrected positions foretell left-out frames better than chance does.
///
/// A correction is work for everybody who uses the result. One that the data do not clearly ask for is not made.
pub(super) fn is_needed(with: &[HeldOut], without: &[HeldOut]) -> bool {
    let gains = with.iter().filter_map(|with| {
        let without = without.iter().find(|without| without.frame == with.frame)?;
        Some(mean(&without.errors.distances_m) - mean(&with.errors.distances_m))
    });
    let gains: Vec<f64> = gains.collect();
    let n = gains.len() as f64;
    let gain = mean(&gains);
    let square: f64 = gains.iter().map(|one| (one - gain).powi(2)).sum();
    // Of one frame, or of frames that cannot be foretold, nothing is known: NaN is not better.
    gain > STANDARD_ERRORS * (square / (n * (n - 1.0))).sqrt()
}

#[cfg(test)]
mod tests {
    use boresight_adjust::SightErrors;
    use boresight_data::{FrameId, Scene};

    use super::*;

    #[test]
    fn a_correction_needs_more_than_chance() {
        let held_out = |means: &[f64]| -> Vec<HeldOut> {
            let one = |(i, mean): (usize, &f64)| HeldOut {
                frame: FrameId(i as u32),
                scene: Scene::default(),
                errors: SightErrors { distances_m: vec![*mean], distances_px: vec![1.0] },
            };
            means.iter().enumerate().map(one).collect()
        };
        for (with, without, needed) in [
            (&[1.0, 1.0, 1.0][..], &[2.0, 3.0, 2.0][..], true),
            (&[1.0, 1.0, 1.0], &[1.0, 3.0, 2.0], false),
            (&[1.0, 1.0, 1.0], &[1.0, 1.0, 1.0], false),
            (&[1.0, 2.0, 1.0], &[2.0, 1.0, 1.1], false),
            (&[2.0, 3.0, 2.0], &[1.0, 1.0, 1.0], false),
            (&[1.0], &[2.0], false),
            (&[1.0, 1.0], &[f64::INFINITY, 2.0], false),
        ] {
            assert_eq!(is_needed(&held_out(with), &held_out(without)), needed, "{with:?} {without:?}");
        }
    }
}
