//! What is known beforehand: holds, an earlier calibration as a prior, lenses that cameras share.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use boresight_adjust::{AdjustOptions, Hold, Prior, Quantity, Share};
use boresight_camera::{Camera, Model, ParamGroup};
use boresight_data::{Calibration, CameraId, Dataset, RigCamera, Scene};
use boresight_io::read_calibration;

use crate::choices::BadChoice;
use crate::error::Error;
use crate::known_rig::POSE_COLUMNS;
use crate::options::{CalibrateOptions, typical_sigma_px};
use crate::shared_lens::{Group, camera_of, sharers};

/// Something that is not estimated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HoldChoice {
    /// `lens`, `pose`, `shape`, or the name of a lens parameter such as `k3`.
    pub what: String,
    /// The camera; `None` is all.
    pub camera: Option<String>,
}

impl FromStr for HoldChoice {
    type Err = BadChoice;

    fn from_str(text: &str) -> Result<Self, BadChoice> {
        let (what, camera) = match text.split_once(':') {
            Some((what, camera)) => (what, Some(camera.to_owned())),
            None => (text, None),
        };
        let is_known = ["lens", "pose", "shape"].contains(&what)
            || Model::names()
                .iter()
                .filter_map(|name| name.parse::<Model>().ok())
                .any(|model| model.param_names().contains(&what));
        if !is_known || camera.as_deref() == Some("") || (what == "shape" && camera.is_some()) {
            let takes = "lens, pose or a lens parameter such as k3, each for all cameras or as lens:NAME for one; shape";
            return Err(BadChoice { value: text.to_owned(), takes });
        }
        Ok(Self { what: what.to_owned(), camera })
    }
}

impl fmt::Display for HoldChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.camera {
            Some(camera) => write!(f, "{}:{camera}", self.what),
            None => f.write_str(&self.what),
        }
    }
}

/// An earlier calibration, and where it was read.
pub(crate) struct Earlier {
    path: String,
    calibration: Calibration,
}

impl Earlier {
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        let (calibration, _) = read_calibration(path)?;
        Ok(Self { path: path.display().to_string(), calibration })
    }

    /// Returns a camera that is known from before.
    fn camera(&self, name: &str) -> Option<&RigCamera> {
        let idx = self.calibration.cameras.iter().position(|camera| camera.name == name)?;
        self.calibration.scene.rig.cameras.as_slice().get(idx)?.as_ref()
    }

    /// Returns the lenses of the dataset's cameras that are known from before.
    pub(crate) fn lenses(&self, dataset: &Dataset) -> Result<Vec<(CameraId, Camera)>, Error> {
        let mut lenses = Vec::new();
        for (id, info) in dataset.cameras.enumerate() {
            let Some(known) = self.camera(&info.name) else { continue };
            if known.camera.image_size != info.image_size {
                let [[was_wide, was_high], [wide, high]] = [known.camera.image_size, info.image_size];
                let why = format!(
                    "camera {} had images of {was_wide}x{was_high} and has {wide}x{high} now",
                    info.name
                );
                return Err(Error::NoPrior { path: self.path.clone(), why });
            }
            lenses.push((id, known.camera.clone()));
        }
        Ok(lenses)
    }

    fn reference(&self) -> Option<&str> {
        let reference = self.calibration.scene.rig.reference()?;
        Some(&self.calibration.cameras[reference].name)
    }

    fn place(&self, name: &str) -> Option<usize> {
        self.calibration.uncertainty.names.iter().position(|known| known == name)
    }

    /// Puts what is known into the seed and returns it as a prior; what was held is held again. `None` if all was.
    ///
    /// Lenses that the job states stay as they are.
    fn apply(
        &self,
        dataset: &Dataset,
        stated: &[(CameraId, Camera)],
        seed: &mut Scene,
        holds: &mut Vec<Hold>,
    ) -> Result<Option<Prior>, Error> {
        let unusable = |why: &str| Error::NoPrior { path: self.path.clone(), why: why.to_owned() };
        if let Some(why) = &self.calibration.uncertainty.unavailable {
            return Err(unusable(why));
        }
        if !dataset.cameras.iter().any(|info| self.camera(&info.name).is_some()) {
            return Err(unusable("it has no camera of this dataset"));
        }
        let uncertainty = &self.calibration.uncertainty;
        let n_all = uncertainty.names.len();
        if uncertainty.covariance.len() != n_all * n_all {
            return Err(unusable("it has no covariance"));
        }
        let reference = seed.rig.reference();
        let same_rig = reference.is_some_and(|id| self.reference() == Some(&dataset.cameras[id].name));
        let row = |place: usize| &uncertainty.covariance[place * n_all..(place + 1) * n_all];
        let (mut quantities, mut places): (Vec<Quantity>, Vec<usize>) = (Vec::new(), Vec::new());
        for (id, info) in dataset.cameras.enumerate() {
            let (Some(known), Some(placed)) = (self.camera(&info.name), &mut seed.rig.cameras[id]) else {
                continue;
            };
            let is_stated = stated.iter().any(|(camera, _)| *camera == id);
            if !is_stated {
                placed.camera.params.clone_from(&known.camera.params);
            }
            let names = if is_stated { Vec::new() } else { known.camera.model.param_names() };
            for (param, name) in names.iter().enumerate() {
                match self.place(&format!("{}.{name}", info.name)) {
                    // Of a lens that cameras shared the same is said of each of them, and counts once.
                    Some(place) if places.iter().any(|known| row(*known) == row(place)) => {}
                    Some(place) => {
                        quantities.push(Quantity::LensParam(id, param, known.camera.params[param]));
                        places.push(place);
                    }
                    None => holds.push(Hold::LensParam(id, param)),
                }
            }
            let columns =
                POSE_COLUMNS.map(|column| self.place(&format!("{}.cam_from_rig.{column}", info.name)));
            if !same_rig {
                continue;
            }
            placed.cam_from_rig = known.cam_from_rig;
            if reference == Some(id) {
                continue;
            }
            if columns.iter().all(Option::is_some) {
                quantities.push(Quantity::CamFromRig(id, known.cam_from_rig));
                places.extend(columns.iter().flatten());
            } else {
                holds.push(Hold::CamFromRig(id));
            }
        }
        if quantities.is_empty() {
            return Ok(None);
        }
        // What is written contains the noise there was, in pixels; the new fit has residuals in units of its
        // stated sigmas, and multiplies by the noise it finds: by the same noise, its square is noise_px² over the
        // mean of their squares.
        let n_corners: usize = self.calibration.cameras.iter().map(|camera| camera.observations).sum();
        let freedom = uncertainty.degrees_of_freedom.max(1) as f64;
        let noise_px = self.calibration.rms_px * (n_corners as f64 / freedom).sqrt();
        let factor = (typical_sigma_px(dataset) / noise_px).powi(2);
        let covariance = places
            .iter()
            .flat_map(|&i| places.iter().map(move |&j| factor * uncertainty.covariance[i * n_all + j]))
            .collect();
        Ok(Some(Prior { quantities, covariance }))
    }
}

/// What is known beforehand.
#[derive(Clone, Copy)]
pub(crate) struct Beliefs<'a> {
    pub options: &'a CalibrateOptions,
    pub earlier: Option<&'a Earlier>,
    /// The lenses that the job states.
    pub stated: &'a [(CameraId, Camera)],
    /// The cameras that share a lens.
    pub groups: &'a [Group],
}

impl Beliefs<'_> {
    /// Puts what is known beforehand into the seed and the options of an adjustment.
    pub(crate) fn apply(
        &self,
        dataset: &Dataset,
        seed: &mut Scene,
        adjust: &mut AdjustOptions,
    ) -> Result<(), Error> {
        if let Some(earlier) = self.earlier {
            let prior = earlier.apply(dataset, self.stated, seed, &mut adjust.holds)?;
            adjust.priors.extend(prior);
        }
        for group in self.groups {
            self.share(dataset, group, seed);
            adjust.shares.push(Share::Lens(group.clone()));
        }
        for (id, placed) in seed.rig.cameras.enumerate() {
            // The surface of a spline can say all that its core does, so that mrcal too leaves the core as it is.
            let is_spline =
                placed.as_ref().is_some_and(|placed| placed.camera.model.local_support().is_some());
            if is_spline && !self.is_told(dataset, id) {
                adjust.holds.extend((0..4).map(|param| Hold::LensParam(id, param)));
            }
        }
        for hold in &self.options.hold {
            self.hold(hold, dataset, seed, &mut adjust.holds)?;
        }
        Ok(())
    }

    /// Tells whether the lens of a camera itself is known.
    fn is_told(&self, dataset: &Dataset, camera: CameraId) -> bool {
        self.stated.iter().any(|(known, _)| *known == camera)
            || self.earlier.is_some_and(|earlier| earlier.camera(&dataset.cameras[camera].name).is_some())
    }

    /// Gives all cameras of a group the lens that is known of one of them, or else that of the first.
    fn share(&self, dataset: &Dataset, group: &Group, seed: &mut Scene) {
        let placed = || group.iter().copied().filter(|id| seed.rig.cameras[*id].is_some());
        let Some(first) = placed().find(|id| self.is_told(dataset, *id)).or_else(|| placed().next()) else {
            return;
        };
        let lens = seed.rig.cameras[first].as_ref().map(|placed| placed.camera.params.clone());
        for id in group {
            if let (Some(placed), Some(lens)) = (&mut seed.rig.cameras[*id], &lens) {
                placed.camera.params.clone_from(lens);
            }
        }
    }

    fn hold(
        &self,
        hold: &HoldChoice,
        dataset: &Dataset,
        seed: &mut Scene,
        holds: &mut Vec<Hold>,
    ) -> Result<(), Error> {
        if hold.what == "shape" {
            holds.push(Hold::Shapes);
            return Ok(());
        }
        let cameras: Vec<CameraId> = match &hold.camera {
            Some(name) => vec![camera_of(dataset, name)?],
            None => dataset.cameras.ids().collect(),
        };
        let name_of = |id: CameraId| dataset.cameras[id].name.as_str();
        let reference = seed.rig.reference();
        let has_pose = |id: CameraId| {
            reference == Some(id)
                || self.earlier.is_some_and(|earlier| {
                    earlier.camera(name_of(id)).is_some() && earlier.reference() == reference.map(name_of)
                })
        };
        let untold =
            |id: CameraId| Error::NothingToHold { camera: name_of(id).to_owned(), what: hold.what.clone() };
        // A parameter that some of all cameras have is held where it is; one that is asked for in vain is an error.
        let mut lacking = None;
        let mut is_found = false;
        for id in cameras {
            let sharers = sharers(self.groups, id);
            let has_lens = sharers.iter().any(|sharer| self.is_told(dataset, *sharer));
            let Some(placed) = &seed.rig.cameras[id] else { continue };
            match hold.what.as_str() {
                "lens" if has_lens => holds.push(Hold::Lens(id)),
                "pose" if has_pose(id) => holds.push(Hold::CamFromRig(id)),
                "lens" | "pose" => return Err(untold(id)),
                name => {
                    let camera = &placed.camera;
                    let Some(param) = camera.model.param_names().iter().position(|known| *known == name)
                    else {
                        lacking = lacking.or(Some(id));
                        continue;
                    };
                    is_found = true;
                    if !has_lens {
                        // What nothing tells is held where a lens without distortion has it.
                        if camera.model.param_groups()[param] == ParamGroup::Focal {
                            return Err(untold(id));
                        }
                        let [fx, fy] = [0, 1].map(|i| camera.params[i]);
                        let [cx, cy] = camera.image_size.map(|size| 0.5 * (f64::from(size) - 1.0));
                        let value = camera.model.undistorted([fx, fy, cx, cy])[param];
                        for sharer in &sharers {
                            if let Some(placed) = &mut seed.rig.cameras[*sharer] {
                                placed.camera.params[param] = value;
                            }
                        }
                    }
                    holds.push(Hold::LensParam(id, param));
                }
            }
        }
        match lacking.and_then(|id| Some((id, seed.rig.cameras[id].as_ref()?.camera.model))) {
            Some((id, model)) if !is_found => Err(Error::NoParameter {
                camera: name_of(id).to_owned(),
                model: model.to_string(),
                what: hold.what.clone(),
                known: model.param_names(),
            }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_are_read_and_written() {
        for text in ["lens", "lens:left", "pose:right", "shape", "k3", "cx:left"] {
            assert_eq!(text.parse::<HoldChoice>().unwrap().to_string(), text);
        }
        for text in ["", "k99", "lens:", "shape:left"] {
            assert!(text.parse::<HoldChoice>().is_err(), "{text}");
        }
    }
}
