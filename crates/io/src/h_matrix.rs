//! The textbook's matrices of each camera: P (intrinsics), M (pose) and H = P M, Eqs 8.10 to 8.14.
//!
//! A point (x, y, z) of the reference frame, in metres, is seen at the pixel (u, v) of an image freed
//! of its lens distortion: `s (u, v, 1) = H (x, y, z, 1)`. Its u0, v0 are cx, cy; pixels count from 0.

use std::fmt::Write as _;

use boresight_camera::textbook::{h_matrix, m_matrix, p_matrix};
use boresight_data::{Calibration, RigCamera};
use boresight_geometry::nalgebra::{Const, Matrix, RawStorage};
use npyz::WriterBuilder as _;
use serde::Serialize;

use crate::Error;
use crate::format::{OutputFile, calibrated};
use crate::json_text::to_json;

/// The schema of the matrices as JSON.
pub const MATRIX_SCHEMA: &str = "boresight.matrix/1";

/// The matrices of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraMatrices {
    /// The camera's name.
    pub name: String,
    /// Its lens model.
    pub model: String,
    /// Width and height of its image in pixels.
    pub image_size: [u32; 2],
    /// The focal length along x in pixels.
    pub fx: f64,
    /// The focal length along y in pixels.
    pub fy: f64,
    /// The principal point along x in pixels.
    pub u0: f64,
    /// The principal point along y in pixels.
    pub v0: f64,
    /// The lens parameters beyond these four, which the matrices leave out.
    pub distortion: Vec<f64>,
    /// From the camera frame to the index frame.
    #[serde(rename = "P")]
    pub p: [[f64; 4]; 3],
    /// From the reference frame to the camera frame, in metres.
    #[serde(rename = "M")]
    pub m: [[f64; 4]; 4],
    /// From the reference frame to the index frame: P M.
    #[serde(rename = "H")]
    pub h: [[f64; 4]; 3],
}

/// Returns the matrices of each calibrated camera, in the order of the rig.
pub fn matrices(calibration: &Calibration) -> Vec<CameraMatrices> {
    calibrated(calibration)
        .map(|(name, RigCamera { camera, cam_from_rig, .. })| {
            let [fx, fy, u0, v0] = [0, 1, 2, 3].map(|i| camera.params[i]);
            let core = [fx, fy, u0, v0];
            CameraMatrices {
                name: name.to_owned(),
                model: camera.model.to_string(),
                image_size: camera.image_size,
                fx,
                fy,
                u0,
                v0,
                distortion: camera.params[4..].to_vec(),
                p: rows(&p_matrix(core)),
                m: rows(&m_matrix(cam_from_rig)),
                h: rows(&h_matrix(core, cam_from_rig)),
            }
        })
        .collect()
}

/// Returns the matrices as commented text; without its comments it is a table of numbers of four columns.
pub fn matrices_to_text(calibration: &Calibration) -> String {
    let matrices = matrices(calibration);
    let reference = matrices.first().map_or("none", |camera| &camera.name);
    let mut text = format!(
        "# Calibration matrices: s (u, v, 1)' = H (x, y, z, 1)' with H = P M.\n\
         # (x, y, z) in metres in the reference frame, that of camera {reference}; (u, v) in pixels, counted from 0,\n\
         # in an image freed of its lens distortion. P maps camera to index frame, M reference to camera frame.\n"
    );
    for camera in &matrices {
        let CameraMatrices { name, model, image_size: [width, height], fx, fy, u0, v0, distortion, p, m, h } =
            camera;
        let _ = write!(
            text,
            "\n# camera {name}: {model}, {width}x{height}\n# fx = {fx}, fy = {fy}, u0 = {u0}, v0 = {v0}\n"
        );
        if !distortion.is_empty() {
            let _ = writeln!(text, "# lens distortion, not in the matrices: {distortion:?}");
        }
        for (letter, matrix) in [("P", &p[..]), ("M", &m[..]), ("H", &h[..])] {
            let _ = writeln!(text, "# {letter} of {name}");
            text.push_str(&aligned(matrix));
        }
    }
    text
}

/// Returns the matrices as JSON, schema [`MATRIX_SCHEMA`].
pub fn matrices_to_json(calibration: &Calibration) -> Vec<u8> {
    #[derive(Serialize)]
    struct Document {
        schema: &'static str,
        reference: Option<String>,
        cameras: Vec<CameraMatrices>,
    }
    let cameras = matrices(calibration);
    let reference = cameras.first().map(|camera| camera.name.clone());
    to_json(&Document { schema: MATRIX_SCHEMA, reference, cameras })
}

/// Returns the matrices H as one NumPy array of doubles, `[camera, 3, 4]`, in the order of the rig.
pub fn matrices_to_npy(calibration: &Calibration) -> Vec<u8> {
    let matrices = matrices(calibration);
    let mut bytes = Vec::new();
    let write = |bytes: &mut Vec<u8>| -> std::io::Result<()> {
        let shape = [matrices.len() as u64, 3, 4];
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(bytes).begin_nd()?;
        writer.extend(matrices.iter().flat_map(|camera| camera.h.as_flattened().iter().copied()))?;
        writer.finish()
    };
    write(&mut bytes).expect("a vector takes all bytes, and the shape is that of the data");
    bytes
}

pub(crate) fn export_text(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    Ok(vec![OutputFile {
        name: "h-matrix.txt".to_owned(),
        bytes: matrices_to_text(calibration).into_bytes(),
    }])
}

pub(crate) fn export_json(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    Ok(vec![OutputFile { name: "h-matrix.json".to_owned(), bytes: matrices_to_json(calibration) }])
}

pub(crate) fn export_npy(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    Ok(vec![OutputFile { name: "h-matrix.npy".to_owned(), bytes: matrices_to_npy(calibration) }])
}

fn rows<const R: usize, S: RawStorage<f64, Const<R>, Const<4>>>(
    matrix: &Matrix<f64, Const<R>, Const<4>, S>,
) -> [[f64; 4]; R] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

/// Returns the rows of a matrix with each column aligned to the right, every digit of it kept.
fn aligned(matrix: &[[f64; 4]]) -> String {
    // Adding zero turns -0 into 0, which reads better.
    let cells: Vec<[String; 4]> =
        matrix.iter().map(|row| row.map(|value| format!("{:?}", value + 0.0))).collect();
    let widths: [usize; 4] = std::array::from_fn(|i| cells.iter().map(|row| row[i].len()).max().unwrap_or(0));
    let mut text = String::new();
    for row in &cells {
        let padded: Vec<String> =
            row.iter().zip(widths).map(|(cell, width)| format!("{cell:>width$}")).collect();
        text.push_str(&padded.join("  "));
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use boresight_geometry::Vector3;

    use super::*;
    use crate::samples::sample;

    #[test]
    fn h_projects_as_the_camera_without_its_distortion() {
        let calibration = sample();
        let point = Vector3::new(0.1, -0.2, 1.5);
        for (matrices, (_, rig_camera)) in matrices(&calibration).iter().zip(calibrated(&calibration)) {
            let in_cam = rig_camera.cam_from_rig * point;
            let expected = [
                matrices.fx * in_cam.x / in_cam.z + matrices.u0,
                matrices.fy * in_cam.y / in_cam.z + matrices.v0,
            ];
            let row = |i: usize| {
                let [a, b, c, d] = matrices.h[i];
                a * point.x + b * point.y + c * point.z + d
            };
            // Pixels of the order of 100 in doubles.
            assert!((row(0) / row(2) - expected[0]).abs() < 1e-10);
            assert!((row(1) / row(2) - expected[1]).abs() < 1e-10);
        }
    }

    #[test]
    fn text_is_a_table_when_comments_are_gone() {
        let text = matrices_to_text(&sample());
        let rows: Vec<Vec<f64>> = text
            .lines()
            .filter(|line| !line.starts_with('#') && !line.is_empty())
            .map(|line| line.split_whitespace().map(|cell| cell.parse().unwrap()).collect())
            .collect();
        assert_eq!(rows.len(), 2 * 10);
        assert!(rows.iter().all(|row| row.len() == 4));
        let expected = matrices(&sample());
        assert_eq!(rows[7..10], expected[0].h);
        assert!(text.contains("u0 = 342.37") && text.contains("# H of right"), "{text}");
    }

    #[test]
    fn json_and_npy_hold_the_same_numbers() {
        let expected = matrices(&sample());
        let json: serde_json::Value = serde_json::from_slice(&matrices_to_json(&sample())).unwrap();
        assert_eq!(json["schema"], MATRIX_SCHEMA);
        assert_eq!(json["cameras"][1]["H"][0][3].as_f64(), Some(expected[1].h[0][3]));
        let bytes = matrices_to_npy(&sample());
        let npy = npyz::NpyFile::new(&bytes[..]).unwrap();
        assert_eq!(npy.shape(), [2, 3, 4]);
        let values: Vec<f64> = npy.into_vec().unwrap();
        assert_eq!(values[12..], *expected[1].h.as_flattened());
    }
}
