//! A calibration with other lens models.

use boresight_camera::Model;
use boresight_data::{Calibration, Uncertainty};
use boresight_seed::{Converted, ImpliedRotation, convert};

use crate::Error;

/// What a change of lens model did to one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvertedCamera {
    /// The camera's name.
    pub name: String,
    /// The model it had.
    pub from: Model,
    /// The camera as it is now, and how far its pixels moved.
    pub converted: Converted,
}

/// Returns the calibration with each camera's lens exchanged for the nearest of `model`, and what
/// that did to each camera.
///
/// Where a camera's orientation changes with its lens, its pose changes with it. The covariance is
/// that of the old lenses and is dropped; residuals are as they were measured with them.
pub fn convert_lenses(
    calibration: &Calibration,
    model: Model,
    rotation: ImpliedRotation,
) -> Result<(Calibration, Vec<ConvertedCamera>), Error> {
    let mut changed = calibration.clone();
    let mut cameras = Vec::new();
    for (placed, fit) in changed.scene.rig.cameras.iter_mut().zip(calibration.cameras.iter()) {
        let Some(placed) = placed else { continue };
        let from = placed.camera.model;
        let converted = convert(&placed.camera, model, rotation)
            .map_err(|source| Error::Convert { camera: fit.name.clone(), source })?;
        placed.camera = converted.camera.clone();
        placed.cam_from_rig = converted.new_from_old * placed.cam_from_rig;
        cameras.push(ConvertedCamera { name: fit.name.clone(), from, converted });
    }
    let unavailable =
        Some(format!("the lenses were converted to {model}; the covariance is that of the originals"));
    changed.uncertainty = Uncertainty { unavailable, ..Uncertainty::default() };
    changed.provenance.options.insert("converted_to".to_owned(), model.to_string());
    Ok((changed, cameras))
}
