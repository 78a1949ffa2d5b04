//! A calibration judged on other data: nothing is estimated but where the targets stood.

use std::collections::BTreeMap;

use boresight_adjust::{AdjustOptions, Regularization, adjust};
use boresight_data::{
    Calibration, CameraId, Dataset, IdVec, Rejection, RejectionReason, Rig, Scene, TargetBelief, Transfer,
};
use boresight_geometry::Pose;
use boresight_seed::place;
use serde::Serialize;

use crate::error::Error;
use crate::held_out::{all_but_frames, transfer, without_rejected};

/// How a calibration meets data that it was not made from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// By camera.
    pub cameras: Vec<CameraVerification>,
    /// The number of frames whose pose was found.
    pub frames: usize,
    /// The number of corners judged.
    pub observations: usize,
    /// The number of corners beyond the limit of an outlier, which were not.
    pub rejected: usize,
    /// The number of corners in views whose camera is not calibrated or whose pose could not be found.
    pub left_out: usize,
    /// Residuals less what the poses of the frames absorb: two for each corner, less six for each frame.
    pub degrees_of_freedom: usize,
    /// The root of the mean squared distance of a corner from its prediction, with the mean taken over
    /// degrees of freedom, in pixels.
    pub rms_px: f64,
    /// `rms_px` over what the calibration's own residuals are by the same measure, its cameras weighed as they are
    /// judged here. One is perfect.
    pub ratio: f64,
    /// How well one camera's view of the target predicts what the others see; `None` for a single camera.
    pub transfer: Option<Transfer>,
    /// Whether the ratio is within its limit.
    pub is_within: bool,
    /// That limit.
    pub limit_ratio: f64,
}

/// How one camera meets the data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraVerification {
    /// The camera's name.
    pub name: String,
    /// OpenCV's RMS over the corners judged, in pixels: `sqrt(sum(du² + dv²) / corners)`.
    pub rms_px: f64,
    /// The same in the calibration itself.
    pub in_sample_rms_px: f64,
    /// The number of views.
    pub views: usize,
    /// The number of corners judged.
    pub observations: usize,
}

/// Judges a calibration on a dataset. Cameras are found by name. A target that is the calibration's own,
/// by name and geometry, has the shape that was found of it; any other is as drawn.
///
/// `options` say what an outlier is and how many threads there are.
pub fn verify(
    calibration: &Calibration,
    dataset: &Dataset,
    options: &AdjustOptions,
    limit_ratio: f64,
) -> Result<Verification, Error> {
    let mut dataset = dataset.clone();
    let scene = known_scene(calibration, &mut dataset)?;
    let start = place(&dataset, &scene);
    if start.rig_from_target.iter().all(Option::is_none) {
        return Err(Error::NothingPlaced { views: dataset.views.len() });
    }
    let holds = all_but_frames(&dataset, &start);
    // What is held needs no regularisation, and its cost is no error of the data.
    let regularization = Regularization::None;
    let options = AdjustOptions { holds, regularization, checkpoint: None, ..options.clone() };
    let met = adjust(&dataset, &start, &options, None)?;
    let frames = met.scene.rig_from_target.iter().flatten().count();
    let observations: usize = met.cameras.iter().map(|camera| camera.observations).sum();
    let freedom = (2 * observations).saturating_sub(6 * frames);
    if freedom == 0 {
        return Err(Error::NothingPlaced { views: dataset.views.len() });
    }
    let is_outlier = |rejection: &&Rejection| matches!(rejection.reason, RejectionReason::Outlier { .. });
    let rejected = met.rejected.iter().filter(is_outlier).count();
    let kept = without_rejected(&dataset, &met);
    let (n, px2, m2) = transfer(&kept, &met.scene, &options)?;
    let rms = |sum: f64| (sum / n.max(1) as f64).sqrt();
    let transfer = (n > 0).then(|| Transfer { observations: n, rms_px: rms(px2), rms_mm: 1e3 * rms(m2) });
    let in_sample: BTreeMap<&str, f64> =
        calibration.cameras.iter().map(|camera| (camera.name.as_str(), camera.rms_px)).collect();
    let judged = |name: &str| {
        let of_camera = met.cameras.iter().find(|camera| camera.name == name);
        of_camera.map_or(0, |camera| camera.observations)
    };
    let rms_px = met.rms_px * (2.0 * observations as f64 / freedom as f64).sqrt();
    // In pixels: corners of photographs and of files may state sigmas that are worlds apart.
    let ratio = rms_px / (2.0f64.sqrt() * calibration.corner_sigma_px(|fit| judged(&fit.name)));
    Ok(Verification {
        cameras: met
            .cameras
            .iter()
            .filter(|camera| camera.observations > 0)
            .map(|camera| CameraVerification {
                name: camera.name.clone(),
                rms_px: camera.rms_px,
                in_sample_rms_px: in_sample.get(camera.name.as_str()).copied().unwrap_or(f64::NAN),
                views: camera.views,
                observations: camera.observations,
            })
            .collect(),
        frames,
        observations,
        rejected,
        left_out: met.rejected.len() - rejected,
        degrees_of_freedom: freedom,
        rms_px,
        ratio,
        transfer,
        is_within: ratio <= limit_ratio,
        limit_ratio,
    })
}

/// Returns the calibration's cameras and targets under the dataset's ids.
fn known_scene(calibration: &Calibration, dataset: &mut Dataset) -> Result<Scene, Error> {
    let find = |name: &str| -> Option<CameraId> {
        calibration.cameras.enumerate().find(|(_, fit)| fit.name == name).map(|(id, _)| id)
    };
    let cameras: IdVec<CameraId, _> = dataset
        .cameras
        .iter()
        .map(|info| calibration.scene.rig.cameras.get(find(&info.name)?)?.clone())
        .collect();
    if cameras.iter().all(Option::is_none) {
        let known = calibration.cameras.iter().map(|fit| fit.name.clone()).collect();
        let name = dataset.cameras.iter().map(|info| info.name.as_str()).collect::<Vec<_>>().join(", ");
        return Err(Error::UnknownCamera { name, known });
    }
    let mut targets = IdVec::default();
    for target in dataset.targets.iter_mut() {
        let known = calibration
            .targets
            .enumerate()
            .find(|(_, own)| own.name == target.name && own.geometry == target.geometry);
        let belief = known.and_then(|(id, own)| {
            target.shape = own.shape;
            calibration.scene.targets.get(id).cloned()
        });
        targets.push(belief.unwrap_or_else(|| {
            target.shape = boresight_data::Shape::Rigid;
            TargetBelief { shape_m: Vec::new(), first_from_target: Pose::identity() }
        }));
    }
    Ok(Scene { rig: Rig { cameras }, targets, ..Scene::default() })
}
