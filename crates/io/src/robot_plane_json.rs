//! `plane.json`: a robot's plane to the last bit, and how it was found.

use std::collections::BTreeMap;
use std::path::Path;

use boresight_data::{Finding, PlaneModel, RobotPlane};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::Place;
use crate::job::read;
use crate::json_text::to_json;

/// The schema of the plane files that are written and read.
pub const PLANE_SCHEMA: &str = "boresight.plane/1";

/// The name of the file in a folder of results.
const PLANE_FILE: &str = "plane.json";

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaneDocument {
    /// [`PLANE_SCHEMA`].
    pub schema: String,
    /// The plane: all that is needed to go from a pixel to the robot.
    pub plane: RobotPlane,
    /// The textbook's λ, in metres per pixel (Eq. 8.25).
    pub lambda_m_per_px: f64,
    /// The textbook's `Hi`, row by row, in metres (Eq. 8.27).
    pub image_in_robot: [[f64; 4]; 4],
    /// The root mean square by which the textbook's procedure misses the touches, in metres.
    pub textbook_rms_m: f64,
    /// All models that were tried.
    pub tried: Vec<TriedDocument>,
    /// How each touch is met.
    pub touches: Vec<TouchDocument>,
    /// The factor by which the stated sigmas must grow to explain the residuals; null without degrees of freedom.
    pub noise_factor: Option<f64>,
    /// Equations minus unknowns.
    pub degrees_of_freedom: usize,
    /// The sigma of a touched coordinate that the covariance rests on, in metres.
    pub sigma_touch_m: f64,
    /// What is doubtful.
    pub findings: Vec<Finding>,
    /// The version that wrote it.
    pub version: String,
    /// Each input file with the blake3 hash of its bytes.
    pub inputs: BTreeMap<String, String>,
}

/// A model that was tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TriedDocument {
    /// The model.
    pub model: PlaneModel,
    /// How well touches that were left out are predicted, in metres; null where they are needed for the fit.
    pub left_out_rms_m: Option<f64>,
    /// How well all touches are met, in metres; null where they do not determine the model.
    pub rms_m: Option<f64>,
}

/// How a touch is met.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TouchDocument {
    /// The touch.
    pub name: String,
    /// Mapped minus touched position, and height, in metres.
    pub residual_m: [f64; 3],
    /// The same in the plane by the fit to all others; null where they are too few.
    pub left_out_m: Option<[f64; 2]>,
}

/// Returns the bytes of `plane.json`.
pub fn plane_to_json(document: &PlaneDocument) -> Result<Vec<u8>, Error> {
    let plane = &document.plane;
    let numbers =
        [&plane.map[..], &plane.height_m, &plane.image_centre, &plane.robot_centre_m, &plane.covariance];
    let scalars = [plane.image_scale, plane.robot_scale_m, document.lambda_m_per_px, document.sigma_touch_m];
    let all = numbers.into_iter().flatten().chain(&scalars).chain(document.image_in_robot.iter().flatten());
    if let Some(&value) = all.into_iter().find(|value| !value.is_finite()) {
        return Err(Error::NotFinite { at: "a number of the plane".to_owned(), value });
    }
    let n = plane.names.len();
    if plane.covariance.len() != n * n {
        return Err(Error::Inconsistent { what: "covariances", found: plane.covariance.len(), need: n * n });
    }
    Ok(to_json(document))
}

/// Reads a `plane.json`, or that of a folder.
pub fn read_plane(path: &Path) -> Result<PlaneDocument, Error> {
    let file = if path.is_dir() { path.join(PLANE_FILE) } else { path.to_owned() };
    let bytes = read(&file)?;
    let name = file.display().to_string();
    let malformed = |error: serde_json::Error| Error::Malformed {
        place: Place::line(&name, error.line()),
        found: error.to_string(),
        need: "a plane as `boresight robot plane` writes it",
    };
    let value: serde_json::Value = serde_json::from_slice(&bytes).map_err(malformed)?;
    let schema = value.get("schema").and_then(|schema| schema.as_str()).unwrap_or("none");
    if schema != PLANE_SCHEMA {
        return Err(Error::Schema { file: name, found: schema.to_owned(), reads: PLANE_SCHEMA });
    }
    let document: PlaneDocument = serde_json::from_slice(&bytes).map_err(malformed)?;
    let plane = &document.plane;
    let need = match plane.model {
        PlaneModel::Similarity | PlaneModel::UndistortedSimilarity => 4,
        PlaneModel::Affine | PlaneModel::UndistortedAffine => 6,
        PlaneModel::Homography | PlaneModel::UndistortedHomography => 8,
        PlaneModel::Pose => 7,
    };
    if plane.map.len() != need || plane.model.needs_lens() != plane.lens.is_some() {
        return Err(Error::BadValue {
            place: Place::file(&name),
            column: "plane.map".to_owned(),
            value: format!("{} numbers", plane.map.len()),
            need: format!("model {} has {need}, and a lens where it needs one", plane.model.name()),
        });
    }
    Ok(document)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn document() -> PlaneDocument {
        PlaneDocument {
            schema: PLANE_SCHEMA.to_owned(),
            plane: RobotPlane {
                model: PlaneModel::Similarity,
                lens: None,
                image_centre: [640.1, 480.2],
                image_scale: 300.0 / 7.0,
                robot_scale_m: 0.1,
                robot_centre_m: [0.4, -0.1],
                facing: -1.0,
                map: vec![0.9, 0.1, 1e-17, -0.0],
                height_m: [0.02, 1e-3, 0.0],
                camera_in_base_m: None,
                tip_in_flange_m: Some([0.0, 0.0, 0.1]),
                names: vec!["map0".to_owned()],
                covariance: vec![1.0 / 3.0],
            },
            lambda_m_per_px: 5e-4,
            image_in_robot: [[1.0, 0.0, 0.0, 0.1]; 4],
            textbook_rms_m: 1e-3,
            tried: vec![TriedDocument {
                model: PlaneModel::Similarity,
                left_out_rms_m: None,
                rms_m: Some(1e-4),
            }],
            touches: vec![TouchDocument { name: "a".to_owned(), residual_m: [0.0; 3], left_out_m: None }],
            noise_factor: Some(1.1),
            degrees_of_freedom: 2,
            sigma_touch_m: 1e-4,
            findings: Vec::new(),
            version: "0".to_owned(),
            inputs: BTreeMap::new(),
        }
    }

    #[test]
    fn a_plane_survives_its_file() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(PLANE_FILE), plane_to_json(&document()).unwrap()).unwrap();
        assert_eq!(read_plane(folder.path()).unwrap(), document());
    }

    #[test]
    fn what_is_no_plane_is_refused() {
        let mut bad = document();
        bad.plane.map[0] = f64::NAN;
        assert!(matches!(plane_to_json(&bad), Err(Error::NotFinite { .. })));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("p.json");
        let mut short = document();
        short.plane.map.pop();
        for (text, expected) in [
            ("{", "a plane as"),
            ("{\"schema\": \"boresight.plane/9\"}", "boresight.plane/9"),
            (std::str::from_utf8(&plane_to_json(&short).unwrap()).unwrap(), "3 numbers"),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = read_plane(&file).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
