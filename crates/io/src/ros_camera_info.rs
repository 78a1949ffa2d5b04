//! ROS's camera_info as YAML, one file per camera: what `camera_info_manager` loads.
//!
//! The keys are those of `camera_calibration_parsers`, the names and orders of coefficients those of
//! `sensor_msgs/CameraInfo`: plumb_bob k1 k2 p1 p2 k3, rational_polynomial k1 k2 p1 p2 k3 to k6, equidistant k1 to k4.
//! Cameras are not rectified: R is the identity and P is K. The format has no place for where a camera sits in a rig,
//! which a comment tells. It is read as OpenCV's YAML is, whose keys it shares.

use boresight_camera::Model;
use boresight_data::{Calibration, RigCamera};

use crate::Error;
use crate::file_storage::yaml_number;
use crate::format::{OutputFile, calibrated, file_stems};

/// Returns ROS's name of a distortion and how many coefficients it has.
fn distortion(model: &Model) -> Option<(&'static str, usize)> {
    match model.name() {
        "pinhole" | "opencv4" | "opencv5" => Some(("plumb_bob", 5)),
        "opencv8" => Some(("rational_polynomial", 8)),
        "kannala-brandt4" => Some(("equidistant", 4)),
        _ => None,
    }
}

pub(crate) fn carries(model: &Model) -> bool {
    distortion(model).is_some()
}

/// Returns the files of a calibration: one for each camera, named after it.
pub(crate) fn export(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    let stems = file_stems(calibrated(calibration).map(|(name, _)| name));
    let files = calibrated(calibration).zip(&stems).map(|((name, rig_camera), stem)| {
        let bytes = write(name, stem, rig_camera)?.into_bytes();
        Ok(OutputFile { name: format!("{stem}.yaml"), bytes })
    });
    files.collect()
}

fn write(
    name: &str,
    stem: &str,
    RigCamera { camera, cam_from_rig, .. }: &RigCamera,
) -> Result<String, Error> {
    let Some((word, count)) = distortion(&camera.model) else {
        let (camera, what) = (name.to_owned(), format!("lens model {}", camera.model));
        return Err(Error::CannotCarry { format: "ros", camera, what, instead: Vec::new() });
    };
    let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| camera.params[i]);
    let coefficients: Vec<f64> =
        (0..count).map(|i| camera.params.get(4 + i).copied().unwrap_or(0.0)).collect();
    let matrix = |key: &str, rows: usize, cols: usize, data: &[f64]| {
        let data = data.iter().map(|value| yaml_number(*value)).collect::<Vec<String>>().join(", ");
        format!("{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [{data}]\n")
    };
    let [width, height] = camera.image_size;
    let [r, t]: [[f64; 3]; 2] = [cam_from_rig.rodrigues().into(), cam_from_rig.translation.into()];
    let head = format!(
        "# written by Boresight {}; not rectified\n# cam_from_rig: Rodrigues vector {r:?}, translation {t:?} m\n\
         image_width: {width}\nimage_height: {height}\n\
         # ROS takes letters, digits and underscores\ncamera_name: {}\n",
        env!("CARGO_PKG_VERSION"),
        stem.replace(|c: char| !c.is_ascii_alphanumeric(), "_")
    );
    Ok([
        head,
        matrix("camera_matrix", 3, 3, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        format!("distortion_model: {word}\n"),
        matrix("distortion_coefficients", 1, count, &coefficients),
        matrix("rectification_matrix", 3, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        matrix("projection_matrix", 3, 4, &[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    ]
    .concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::cameras_from_bytes;
    use crate::samples::{calibration, lens, rig};

    #[test]
    fn what_is_written_is_read_again() {
        for (model, count, word) in [
            ("pinhole", 0, "plumb_bob"),
            ("opencv5", 5, "plumb_bob"),
            ("opencv8", 8, "rational_polynomial"),
            ("kannala-brandt4", 4, "equidistant"),
        ] {
            let cameras = rig(&[(model, lens(count)), (model, lens(count))]);
            let files = export(&calibration(cameras.clone())).unwrap();
            let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
            assert_eq!(names, ["left.yaml", "right.yaml"]);
            let text = String::from_utf8(files[1].bytes.clone()).unwrap();
            assert!(text.contains(&format!("distortion_model: {word}\n")), "{text}");
            let read = cameras_from_bytes("right.yaml", &files[1].bytes).unwrap();
            assert_eq!((&read[0].name[..], &read[0].camera), ("right", &cameras[1].as_ref().unwrap().camera));
        }
        // Four coefficients are five with a k3 of zero, which is the same lens.
        let files = export(&calibration(rig(&[("opencv4", lens(4))]))).unwrap();
        let read = cameras_from_bytes("left.yaml", &files[0].bytes).unwrap();
        assert_eq!(read[0].camera.params[..8], lens(4));
        assert_eq!(read[0].camera.params.get(8).copied().unwrap_or(0.0), 0.0);
    }
}
