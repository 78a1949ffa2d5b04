//! Cross-validation: the odd frames and the even frames calibrated apart, and whether the two differ by
//! more than their uncertainties say.
//!
//! Noise makes two calibrations of the same cameras differ by what both predict. If they differ by
//! more, something is at work that is not in the model: a lens that it cannot describe, a board that is
//! not as drawn, images that were not taken at once.

use std::collections::BTreeSet;

use boresight_adjust::{AdjustOptions, Rejection, adjust};
use boresight_data::{Calibration, Dataset, FrameId};
use boresight_validate::{CompareOptions, ComparedCamera, RigComparison, compare_known_rigs};

use crate::error::Error;
use crate::held_out::{with_views, without_rejected};

/// Returns the comparison of the calibrations from every other frame of `dataset`: the first, third
/// and so on as a, the rest as b. Corners that `calibration` rejects are in neither, and both start from it.
///
/// `options` are those that `calibration` was made with. What they believe beforehand is left out: both halves would
/// lean on it, and differ by less than their uncertainties say.
pub fn cross_validate(
    dataset: &Dataset,
    calibration: &Calibration,
    options: &AdjustOptions,
    compare: &CompareOptions,
) -> Result<RigComparison, Error> {
    let [a, b] = halves(dataset, calibration, options)?;
    let uncertainties = [Some(&a.uncertainty), Some(&b.uncertainty)];
    Ok(compare_known_rigs(&compared(&a), &compared(&b), uncertainties, compare)?)
}

/// Returns the calibrations from every other frame.
pub(crate) fn halves(
    dataset: &Dataset,
    calibration: &Calibration,
    options: &AdjustOptions,
) -> Result<[Calibration; 2], Error> {
    let kept = without_rejected(dataset, calibration);
    let frames: BTreeSet<FrameId> = kept.views.iter().map(|view| view.frame).collect();
    let options =
        AdjustOptions { rejection: Rejection::None, priors: Vec::new(), checkpoint: None, ..options.clone() };
    let half = |first: usize| -> Result<Calibration, Error> {
        let own: BTreeSet<FrameId> = frames.iter().copied().skip(first).step_by(2).collect();
        let part = with_views(&kept, |view| own.contains(&view.frame));
        Ok(adjust(&part, &calibration.scene, &options, None)?)
    };
    let (a, b) = rayon::join(|| half(0), || half(1));
    Ok([a?, b?])
}

/// Returns the cameras of a calibration that were calibrated, ready to be compared.
pub fn compared(calibration: &Calibration) -> Vec<ComparedCamera> {
    let cameras = calibration.cameras.iter().zip(&calibration.scene.rig.cameras);
    cameras
        .filter_map(|(fit, placed)| {
            let placed = placed.as_ref()?;
            Some(ComparedCamera {
                name: fit.name.clone(),
                camera: placed.camera.clone(),
                cam_from_rig: Some(placed.cam_from_rig),
            })
        })
        .collect()
}
