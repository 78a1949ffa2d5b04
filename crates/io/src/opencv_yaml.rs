//! OpenCV calibrations as YAML: the keys of calibration.cpp for one camera, of stereo_calib.cpp for two.
//!
//! Written are one file per camera, and for two cameras `stereo.yml`, for more `extrinsics.yml`; poses
//! and translations in metres. Read are `camera_matrix` with `distortion_coefficients` (a ROS
//! camera_info has the same), `K` with `D`, and `M1 D1 M2 D2 R T` or `K1 D1 K2 D2 R T`. Four coefficients
//! are a fisheye's where `fisheye_model` is 1 or `distortion_model` says so. OpenCV pads with zeros, so
//! trailing coefficients of zero make a smaller model, and none but zeros a pinhole.

use boresight_camera::{Camera, Model};
use boresight_data::{Calibration, Geometry, RigCamera};
use boresight_geometry::{Matrix3, Pose, Vector3};

use crate::file_storage::{Matrix, Node, Value, read_file_storage, yaml_matrix};
use crate::format::{NamedCamera, OutputFile, calibrated, file_stems, holds, stem_of};
use crate::{Error, Place};

const HEAD: &str = "%YAML:1.0\n---\n";
/// The names of a lens's and of its coefficients' matrix.
const LENS_KEYS: [(&str, &str); 2] = [("camera_matrix", "distortion_coefficients"), ("K", "D")];
const PAIR_KEYS: [[(&str, &str); 2]; 2] = [[("M1", "D1"), ("M2", "D2")], [("K1", "D1"), ("K2", "D2")]];
const ORTHONORMAL: f64 = 1e-6;

pub(crate) fn carries(model: &Model) -> bool {
    matches!(model.name(), "pinhole" | "kannala-brandt4") || model.name().starts_with("opencv")
}

pub(crate) fn recognizes(bytes: &[u8]) -> bool {
    bytes.starts_with(b"%YAML") || holds(bytes, "!!opencv-matrix") || holds(bytes, "camera_matrix:")
}

pub(crate) fn read_cameras(file: &str, bytes: &[u8]) -> Result<Vec<NamedCamera>, Error> {
    let root = read_file_storage(file, bytes)?;
    let reader = Reader { file, root: &root };
    for [first, second] in PAIR_KEYS {
        if root.get(first.0).is_none() || root.get(second.0).is_none() {
            continue;
        }
        let names = reader.names().unwrap_or_else(|| ["camera1".to_owned(), "camera2".to_owned()]);
        let second_from_first = reader.pose()?;
        let first_pose = second_from_first.map(|_| Pose::identity());
        let [first_name, second_name] = names;
        return Ok(vec![
            NamedCamera {
                camera: reader.camera(first, &first_name)?,
                name: first_name,
                cam_from_rig: first_pose,
                covariance: None,
            },
            NamedCamera {
                camera: reader.camera(second, &second_name)?,
                name: second_name,
                cam_from_rig: second_from_first,
                covariance: None,
            },
        ]);
    }
    for keys in LENS_KEYS {
        if root.get(keys.0).is_some() {
            let name =
                root.get("camera_name").and_then(Node::text).map_or_else(|| stem_of(file), str::to_owned);
            return Ok(vec![NamedCamera {
                camera: reader.camera(keys, &name)?,
                name,
                cam_from_rig: None,
                covariance: None,
            }]);
        }
    }
    Err(Error::Malformed {
        place: Place::file(file),
        found: "the file has no camera".to_owned(),
        need: "a camera is camera_matrix, K, or M1 and M2, with its distortion coefficients",
    })
}

pub(crate) fn export(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    let cameras: Vec<(&str, &RigCamera)> = calibrated(calibration).collect();
    let stems = file_stems(cameras.iter().map(|(name, _)| *name).chain(["stereo", "extrinsics"]));
    let mut files: Vec<OutputFile> = cameras
        .iter()
        .zip(&stems)
        .map(|((name, rig_camera), stem)| {
            let text = one_camera(calibration, name, &rig_camera.camera);
            OutputFile { name: format!("{stem}.yml"), bytes: text.into_bytes() }
        })
        .collect();
    let (joint, stem) = match cameras[..] {
        [] | [_] => return Ok(files),
        [first, second] => (stereo(first, second), &stems[2]),
        _ => (poses_of_all(&cameras), &stems[cameras.len() + 1]),
    };
    files.push(OutputFile { name: format!("{stem}.yml"), bytes: joint.into_bytes() });
    Ok(files)
}

fn one_camera(calibration: &Calibration, name: &str, camera: &Camera) -> String {
    let fit = calibration.cameras.iter().find(|fit| fit.name == name);
    let mut text = format!("{HEAD}camera_name: {}\n", quoted(name));
    if let Some(fit) = fit {
        text.push_str(&format!("nframes: {}\n", fit.views));
    }
    text.push_str(&image_size(camera));
    let boards = calibration.targets.iter().filter_map(|target| match target.geometry {
        Geometry::Chessboard { spacing_m, .. }
        | Geometry::Charuco { spacing_m, .. }
        | Geometry::Circles { spacing_m, .. } => {
            target.geometry.grid().map(|[columns, rows]| (columns, rows, spacing_m))
        }
        Geometry::AprilGrid { .. } | Geometry::Points { .. } => None,
    });
    for (columns, rows, spacing_m) in boards.take(1) {
        text.push_str(&format!(
            "board_width: {columns}\nboard_height: {rows}\nsquare_size: {}\n",
            crate::file_storage::yaml_number(spacing_m)
        ));
    }
    text.push_str(&format!("flags: {}\n{}", flags(camera.model.name()), fisheye(&[camera])));
    text.push_str(&lens("camera_matrix", "distortion_coefficients", camera));
    if let Some(fit) = fit.filter(|fit| fit.rms_px.is_finite()) {
        text.push_str(&format!("avg_reprojection_error: {}\n", crate::file_storage::yaml_number(fit.rms_px)));
    }
    text
}

fn stereo(first: (&str, &RigCamera), second: (&str, &RigCamera)) -> String {
    let second_from_first = second.1.cam_from_rig * first.1.cam_from_rig.inverse();
    let cameras = [&first.1.camera, &second.1.camera];
    let mut text = format!("{HEAD}camera_names:\n   - {}\n   - {}\n", quoted(first.0), quoted(second.0));
    text.push_str(&image_size(cameras[0]));
    text.push_str(&fisheye(&cameras));
    text.push_str(&lens("M1", "D1", cameras[0]));
    text.push_str(&lens("M2", "D2", cameras[1]));
    text.push_str(&pose("R", "T", &second_from_first));
    text
}

/// Lists the pose of each camera; R and T with the camera's number, counted from 1, are `cam_from_rig`.
fn poses_of_all(cameras: &[(&str, &RigCamera)]) -> String {
    let names: String = cameras.iter().map(|(name, _)| format!("   - {}\n", quoted(name))).collect();
    let poses = cameras.iter().enumerate().map(|(i, (_, RigCamera { cam_from_rig, .. }))| {
        pose(&format!("R{}", i + 1), &format!("T{}", i + 1), cam_from_rig)
    });
    format!("{HEAD}camera_names:\n{names}{}", poses.collect::<String>())
}

fn image_size(camera: &Camera) -> String {
    format!("image_width: {}\nimage_height: {}\n", camera.image_size[0], camera.image_size[1])
}

fn lens(matrix_key: &str, coefficients_key: &str, camera: &Camera) -> String {
    let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| camera.params[i]);
    let coefficients = match &camera.params[4..] {
        [] => &[0.0; 5],
        coefficients => coefficients,
    };
    let matrix = yaml_matrix(matrix_key, 3, 3, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    matrix + &yaml_matrix(coefficients_key, coefficients.len(), 1, coefficients)
}

fn pose(rotation_key: &str, translation_key: &str, pose: &Pose) -> String {
    let rotation = pose.rotation_matrix().transpose();
    let translation: [f64; 3] = pose.translation.into();
    yaml_matrix(rotation_key, 3, 3, rotation.as_slice()) + &yaml_matrix(translation_key, 3, 1, &translation)
}

/// Marks cameras whose four coefficients are a fisheye's; a pair is marked only if both are.
fn fisheye(cameras: &[&Camera]) -> String {
    let all = cameras.iter().all(|camera| camera.model.name() == "kannala-brandt4");
    if all { "fisheye_model: 1\n".to_owned() } else { String::new() }
}

/// Returns calibrateCamera's flags for a lens model.
fn flags(model: &str) -> u32 {
    const ZERO_TANGENT: u32 = 8;
    const FIX_K1_K2_K3: [u32; 3] = [32, 64, 128];
    const RATIONAL: u32 = 0x4000;
    const THIN_PRISM: u32 = 0x8000;
    const TILTED: u32 = 0x40000;
    match model {
        "pinhole" => ZERO_TANGENT + FIX_K1_K2_K3.iter().sum::<u32>(),
        "opencv4" => FIX_K1_K2_K3[2],
        "opencv8" => RATIONAL,
        "opencv12" => RATIONAL | THIN_PRISM,
        "opencv14" => RATIONAL | THIN_PRISM | TILTED,
        _ => 0,
    }
}

fn quoted(name: &str) -> String {
    let escaped: String =
        name.chars().flat_map(|c| if "\"\\".contains(c) { vec!['\\', c] } else { vec![c] }).collect();
    format!("\"{}\"", escaped.replace(char::is_control, " "))
}

struct Reader<'a> {
    file: &'a str,
    root: &'a Node,
}

impl Reader<'_> {
    fn bad(&self, node: &Node, key: &str, value: String, need: &str) -> Error {
        let place = Place::line(self.file, node.line);
        Error::BadValue { place, column: key.to_owned(), value, need: need.to_owned() }
    }

    fn camera(&self, (matrix_key, coefficients_key): (&str, &str), name: &str) -> Result<Camera, Error> {
        let (node, matrix) = self.matrix(matrix_key)?.ok_or_else(|| Error::BadValue {
            place: Place::file(self.file),
            column: matrix_key.to_owned(),
            value: "missing".to_owned(),
            need: "a camera has a matrix".to_owned(),
        })?;
        let [fx, skew, cx, zero, fy, cy, a, b, one] = matrix.data[..] else {
            let value = format!("{}x{}", matrix.rows, matrix.cols);
            return Err(self.bad(node, matrix_key, value, "a camera matrix is 3x3"));
        };
        if [skew, zero, a, b] != [0.0; 4] || one != 1.0 {
            let value = format!("{:?}", matrix.data);
            return Err(self.bad(
                node,
                matrix_key,
                value,
                "[fx 0 cx; 0 fy cy; 0 0 1] is needed, without skew",
            ));
        }
        let coefficients = self.matrix(coefficients_key)?;
        let data = coefficients.as_ref().map_or(&[][..], |(_, matrix)| &matrix.data);
        let model = self.model(data).ok_or_else(|| {
            let need = "there are 4, 5, 8, 12 or 14 distortion coefficients, 4 for a fisheye";
            self.bad(
                coefficients.as_ref().map_or(node, |(node, _)| node),
                coefficients_key,
                data.len().to_string(),
                need,
            )
        })?;
        let lens = |source| Error::Lens {
            place: Place::line(self.file, node.line),
            camera: name.to_owned(),
            source: Box::new(source),
        };
        let model: Model = model.parse().map_err(lens)?;
        let count = model.param_count() - 4;
        let params = [fx, fy, cx, cy].into_iter().chain(data.iter().copied().take(count)).collect();
        Camera::new(model, params, self.image_size()?).map_err(lens)
    }

    /// Returns the name of the smallest lens model with these coefficients.
    fn model(&self, coefficients: &[f64]) -> Option<&'static str> {
        let flag = self.root.get("fisheye_model").and_then(Node::number).is_some_and(|flag| flag != 0.0);
        let word = self.root.get("distortion_model").and_then(Node::text);
        if flag || word.is_some_and(|word| ["equidistant", "fisheye"].contains(&word)) {
            return (coefficients.len() == 4).then_some("kannala-brandt4");
        }
        let used = coefficients.len() - coefficients.iter().rev().take_while(|value| **value == 0.0).count();
        match (coefficients.len(), used) {
            (0 | 4 | 5 | 8 | 12 | 14, 0) => Some("pinhole"),
            (4, _) => Some("opencv4"),
            (5, _) | (8 | 12 | 14, ..=5) => Some("opencv5"),
            (8 | 12 | 14, ..=8) => Some("opencv8"),
            (12 | 14, ..=12) => Some("opencv12"),
            (14, _) => Some("opencv14"),
            _ => None,
        }
    }

    fn image_size(&self) -> Result<[u32; 2], Error> {
        let mut size = [0; 2];
        for (axis, key) in ["image_width", "image_height"].into_iter().enumerate() {
            let Some(node) = self.root.get(key) else { return Ok([0, 0]) };
            let number = node.number().filter(|n| n.fract() == 0.0 && (0.0..=1e6).contains(n));
            let value = node.text().unwrap_or("no number").to_owned();
            size[axis] =
                number.ok_or_else(|| self.bad(node, key, value, "it must be a number of pixels"))? as u32;
        }
        Ok(size)
    }

    fn matrix(&self, key: &str) -> Result<Option<(&Node, Matrix)>, Error> {
        let Some(node) = self.root.get(key) else { return Ok(None) };
        let matrix =
            node.matrix().map_err(|value| self.bad(node, key, value, "it must be a matrix of numbers"))?;
        Ok(Some((node, matrix)))
    }

    fn names(&self) -> Option<[String; 2]> {
        let Value::List(names) = &self.root.get("camera_names")?.value else { return None };
        let names: Vec<String> = names.iter().filter_map(|name| name.text().map(str::to_owned)).collect();
        names.try_into().ok()
    }

    /// Returns the pose of R and T, where both are given.
    fn pose(&self) -> Result<Option<Pose>, Error> {
        let (Some((node, rotation)), Some((t_node, translation))) = (self.matrix("R")?, self.matrix("T")?)
        else {
            return Ok(None);
        };
        if translation.data.len() != 3 || !translation.data.iter().all(|value| value.is_finite()) {
            return Err(self.bad(
                t_node,
                "T",
                format!("{:?}", translation.data),
                "a translation has 3 numbers",
            ));
        }
        if rotation.data.len() != 9 {
            let value = format!("{}x{}", rotation.rows, rotation.cols);
            return Err(self.bad(node, "R", value, "a rotation is a 3x3 matrix"));
        }
        let matrix = Matrix3::from_row_slice(&rotation.data);
        let excess = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
        if excess.is_nan() || excess > ORTHONORMAL || matrix.determinant() < 0.0 {
            let value = format!("{:?}", rotation.data);
            return Err(self.bad(node, "R", value, "a rotation is orthonormal and right-handed"));
        }
        Ok(Some(Pose::from_matrix(&matrix, Vector3::from_row_slice(&translation.data))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::{calibration, lens, rig};

    fn text(files: &[OutputFile], name: &str) -> String {
        let file = files.iter().find(|file| file.name == name).unwrap();
        String::from_utf8(file.bytes.clone()).unwrap()
    }

    #[test]
    fn a_pair_is_written_as_stereo_calib_writes_it() {
        let cameras = rig(&[("opencv5", lens(5)), ("opencv8", lens(8))]);
        let files = export(&calibration(cameras.clone())).unwrap();
        let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names, ["left.yml", "right.yml", "stereo.yml"]);
        let stereo = text(&files, "stereo.yml");
        assert!(stereo.starts_with("%YAML:1.0\n---\n"));
        let read = read_cameras("stereo.yml", stereo.as_bytes()).unwrap();
        for (read, written) in read.iter().zip(cameras.iter().flatten()) {
            assert_eq!(read.camera, written.camera);
            let apart = read.cam_from_rig.unwrap() * written.cam_from_rig.inverse();
            // A rotation through a matrix and back loses a few last bits.
            assert!(apart.log().norm() < 1e-14);
        }
        assert_eq!(read[1].name, "right");
    }

    #[test]
    fn a_rig_is_a_file_per_camera_and_one_of_poses() {
        let cameras = rig(&[("pinhole", lens(0)), ("opencv14", lens(14)), ("kannala-brandt4", lens(4))]);
        let files = export(&calibration(cameras)).unwrap();
        assert_eq!(files[3].name, "extrinsics.yml");
        let fisheye = text(&files, "cam2.yml");
        assert!(fisheye.contains("fisheye_model: 1\n"));
        assert_eq!(
            read_cameras("cam2.yml", fisheye.as_bytes()).unwrap()[0].camera.model.name(),
            "kannala-brandt4"
        );
        let error = read_cameras("extrinsics.yml", &files[3].bytes).unwrap_err().to_string();
        assert!(error.contains("no camera"), "{error}");
    }

    #[test]
    fn what_is_wrong_is_said_with_line_and_value() {
        let one = export(&calibration(rig(&[("opencv5", lens(5))]))).unwrap();
        let good = text(&one, "left.yml");
        let refuses = |from: &str, to: &str, part: &str| {
            assert!(good.contains(from), "{from} in {good}");
            let error = read_cameras("c.yml", good.replacen(from, to, 1).as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with("c.yml:") && error.contains(part), "`{part}` is not in: {error}");
        };
        refuses("rows: 3", "rows: 2", "2x3 with 9 numbers");
        refuses("rows: 5", "rows: 6", "6x1 with 5 numbers");
        refuses("[ 5.36", "[ -5.36", "fx");
        refuses("[ 5.36", "[ .Nan, 5.36", "3x3 with 10 numbers");
        refuses("image_width: 640", "image_width: wide", "image_width is `wide`");
        refuses("flags: 0\n", "fisheye_model: 1\n", "distortion_coefficients is `5`");
        refuses(", 0., ", ", 1., ", "without skew");
    }

    #[test]
    fn files_of_opencv_are_read_where_present() {
        for (file, count, model, size) in [
            ("conformance/opencv/formats/cam_4.14.0.yml", 1, "opencv5", [0, 0]),
            ("conformance/opencv/formats/cam_5.0.0.yml", 1, "opencv5", [0, 0]),
            ("datasets/stereo-opencv-left-right/raw/left_intrinsics.yml", 1, "opencv5", [640, 480]),
            ("datasets/stereo-opencv-left-right/raw/intrinsics.yml", 2, "opencv5", [0, 0]),
        ] {
            let Some(path) = crate::samples::shared_file(file) else { continue };
            let bytes = std::fs::read(path).unwrap();
            let cameras = read_cameras(file, &bytes).unwrap();
            assert_eq!(cameras.len(), count, "{file}");
            assert_eq!(cameras[0].camera.model.name(), model, "{file}");
            assert_eq!(cameras[0].camera.image_size, size, "{file}");
        }
    }
}
