//! How well a calibration is known, in the units it is used in: from its file alone.

use boresight_data::{Calibration, CameraId};
use boresight_validate::{
    AtDistance, Method, ProjectionUncertainty, Propagation, StereoUncertainty, UncertaintyMap,
    stereo_uncertainty,
};
use serde::Serialize;

use crate::error::Error;

/// What to work out.
#[derive(Clone, Debug, PartialEq)]
pub struct UncertaintyOptions {
    /// The names of the cameras; empty takes all that are calibrated.
    pub cameras: Vec<String>,
    /// The distances in metres; infinity is one of them where it is `None`.
    pub distances_m: Vec<Option<f64>>,
    /// The number of grid points across an image, and down.
    pub grid: [usize; 2],
    /// How the motion of the targets is taken out.
    pub method: Method,
    /// What counts as known.
    pub propagation: Propagation,
}

impl Default for UncertaintyOptions {
    fn default() -> Self {
        Self {
            cameras: Vec::new(),
            distances_m: vec![Some(0.5), Some(1.0), Some(3.0), Some(10.0), None],
            grid: [60, 40],
            method: Method::default(),
            propagation: Propagation::default(),
        }
    }
}

/// How well a calibration is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UncertaintyReport {
    /// How the motion of the targets was taken out.
    pub method: Method,
    /// What counted as known.
    pub propagation: Propagation,
    /// By camera.
    pub cameras: Vec<CameraUncertainty>,
    /// By two cameras and distance, where both see something at it.
    pub pairs: Vec<StereoUncertainty>,
}

/// How well a camera's projections are known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraUncertainty {
    /// The camera's name.
    pub name: String,
    /// At the middle of the image, by distance.
    pub middle: Vec<AtDistance>,
    /// Over the image, by distance.
    pub maps: Vec<UncertaintyMap>,
}

/// Returns how well the calibration's projections and distances are known.
pub fn uncertainty(
    calibration: &Calibration,
    options: &UncertaintyOptions,
) -> Result<UncertaintyReport, Error> {
    let name = |id: CameraId| calibration.cameras[id].name.clone();
    let calibrated: Vec<CameraId> = calibration
        .scene
        .rig
        .cameras
        .enumerate()
        .filter(|(id, camera)| camera.is_some() && calibration.cameras.get(*id).is_some())
        .map(|(id, _)| id)
        .collect();
    if let Some(unknown) =
        options.cameras.iter().find(|wanted| !calibrated.iter().any(|&id| name(id) == **wanted))
    {
        let known = calibrated.iter().map(|&id| name(id)).collect();
        return Err(Error::UnknownCamera { name: unknown.clone(), known });
    }
    let chosen: Vec<CameraId> = calibrated
        .into_iter()
        .filter(|&id| options.cameras.is_empty() || options.cameras.contains(&name(id)))
        .collect();
    let mut cameras = Vec::new();
    for &id in &chosen {
        let known = ProjectionUncertainty::new(calibration, id, options.method, options.propagation)?;
        let middle = known.camera().image_size.map(|size| 0.5 * (f64::from(size) - 1.0));
        let [columns, rows] = options.grid;
        let maps = options.distances_m.iter().map(|&distance| known.map(columns, rows, distance));
        cameras.push(CameraUncertainty {
            name: name(id),
            middle: known.with_distance(middle, &options.distances_m)?,
            maps: maps.collect::<Result<_, _>>()?,
        });
    }
    let mut pairs = Vec::new();
    for (i, &from) in chosen.iter().enumerate() {
        for &to in &chosen[i + 1..] {
            for distance in options.distances_m.iter().flatten() {
                pairs.extend(stereo_uncertainty(calibration, [from, to], *distance, options.propagation)?);
            }
        }
    }
    Ok(UncertaintyReport { method: options.method, propagation: options.propagation, cameras, pairs })
}
