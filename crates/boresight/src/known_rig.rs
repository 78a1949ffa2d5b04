//! A calibration to be used: its cameras, and the joint covariance of what was estimated of them.

use std::path::Path;

use boresight_camera::Camera;
use boresight_data::Uncertainty;
use boresight_geometry::nalgebra::DMatrix;
use boresight_io::{NamedCamera, read_calibration, read_cameras};

use crate::error::Error;
use crate::robot_error::RobotError;

/// The name of the calibration in a folder of results.
const CALIBRATION: &str = "calibration.json";

/// The six perturbations of a pose, as an uncertainty names them.
pub(crate) const POSE_COLUMNS: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"];

/// Cameras to be used, with what is known of their errors.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownRig {
    /// The cameras.
    pub cameras: Vec<NamedCamera>,
    /// The names of the columns of `covariance`, such as `left.fx`; none where the file tells no covariance.
    pub names: Vec<String>,
    /// The joint covariance, row by row.
    pub covariance: Vec<f64>,
}

impl KnownRig {
    /// Reads a calibration.json or the folder it is in, a .cameramodel or an OpenCV .yml.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let file = if path.is_dir() { path.join(CALIBRATION) } else { path.to_owned() };
        let cameras = read_cameras(&file)?;
        let is_native = file.extension().is_some_and(|extension| extension == "json");
        let known = if is_native { Some(read_calibration(&file)?.0.uncertainty) } else { None };
        Ok(Self::new(cameras, known.as_ref()))
    }

    /// Returns the rig of these cameras and this uncertainty.
    pub fn new(cameras: Vec<NamedCamera>, uncertainty: Option<&Uncertainty>) -> Self {
        let (names, covariance) = uncertainty
            .map(|uncertainty| (uncertainty.names.clone(), uncertainty.covariance.clone()))
            .filter(|(names, covariance)| covariance.len() == names.len() * names.len())
            .unwrap_or_default();
        Self { cameras, names, covariance }
    }

    /// Returns the camera of this name, or the only one.
    pub fn camera(&self, name: Option<&str>) -> Result<&NamedCamera, Error> {
        let found = match name {
            Some(name) => self.cameras.iter().find(|camera| camera.name == name),
            None if self.cameras.len() == 1 => self.cameras.first(),
            None => None,
        };
        found.ok_or_else(|| {
            let known = self.cameras.iter().map(|camera| camera.name.clone()).collect();
            RobotError::NoSuchCamera { name: name.unwrap_or_default().to_owned(), known }.into()
        })
    }

    /// Returns the joint covariance of parameters by name, zero for those that were held; `None` where
    /// none of them was estimated.
    pub fn covariance_of(&self, wanted: &[String]) -> Option<DMatrix<f64>> {
        let columns: Vec<Option<usize>> =
            wanted.iter().map(|name| self.names.iter().position(|known| known == name)).collect();
        columns.iter().any(Option::is_some).then(|| {
            DMatrix::from_fn(wanted.len(), wanted.len(), |i, j| match (columns[i], columns[j]) {
                (Some(a), Some(b)) => self.covariance[a * self.names.len() + b],
                _ => 0.0,
            })
        })
    }

    /// Returns the covariance of all parameters of a camera's lens.
    pub fn lens_covariance(&self, camera: &NamedCamera) -> Option<DMatrix<f64>> {
        self.covariance_of(&lens_names(&camera.name, &camera.camera))
    }
}

/// Returns the names of a camera's lens parameters, as an uncertainty has them.
pub(crate) fn lens_names(name: &str, camera: &Camera) -> Vec<String> {
    camera.model.param_names().iter().map(|param| format!("{name}.{param}")).collect()
}
