//! Kalibr's `camchain.yaml`: all cameras of a rig, each with its pose relative to the one before.
//!
//! The public page "Yaml formats" of Kalibr's wiki names the keys, "Supported models" the orders of the numbers:
//! pinhole `[fu fv pu pv]`, omni `[xi fu fv pu pv]`, ds `[xi alpha fu fv pu pv]`, eucm `[alpha beta fu fv pu pv]`;
//! radtan `[k1 k2 r1 r2]`, equidistant `[k1 k2 k3 k4]`. Pixels and axes are as here. Cameras are called cam0, cam1
//! and so on there; the name is kept as the topic, `/NAME/image_raw`.

use boresight_camera::{Camera, Model};
use boresight_data::{Calibration, RigCamera};
use boresight_geometry::{Matrix3, Pose, Vector3};

use crate::file_storage::{Node, Value, read_file_storage, yaml_number};
use crate::format::{NamedCamera, OutputFile, calibrated, distinct, holds};
use crate::{Error, Place};

/// Our name, Kalibr's projection and distortion, and where each of Kalibr's numbers stands among our parameters:
/// first of the intrinsics, then of the distortion.
type Lens = (&'static str, &'static str, &'static str, &'static [usize], &'static [usize]);

const LENSES: [Lens; 6] = [
    ("opencv4", "pinhole", "radtan", &[0, 1, 2, 3], &[4, 5, 6, 7]),
    ("pinhole", "pinhole", "none", &[0, 1, 2, 3], &[]),
    ("kannala-brandt4", "pinhole", "equidistant", &[0, 1, 2, 3], &[4, 5, 6, 7]),
    ("mei", "omni", "radtan", &[4, 0, 1, 2, 3], &[5, 6, 7, 8]),
    ("double-sphere", "ds", "none", &[4, 5, 0, 1, 2, 3], &[]),
    ("eucm", "eucm", "none", &[4, 5, 0, 1, 2, 3], &[]),
];
/// Rotations are orthonormal to this: Kalibr writes all digits, people fewer.
const ORTHONORMAL: f64 = 1e-4;

fn lens_of(model: &Model) -> Option<&'static Lens> {
    LENSES.iter().find(|(ours, ..)| *ours == model.name())
}

pub(crate) fn carries(model: &Model) -> bool {
    lens_of(model).is_some()
}

pub(crate) fn recognizes(bytes: &[u8]) -> bool {
    ["camera_model:", "intrinsics:", "cam0:"].iter().all(|key| holds(bytes, key))
}

/// Returns the one file of a calibration.
pub(crate) fn export(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    let mut text = format!("# written by Boresight {}\n", env!("CARGO_PKG_VERSION"));
    let names = calibrated(calibration).map(|(name, _)| name.trim_matches('/'));
    let topics = distinct(names, "-_./");
    let mut before: Option<Pose> = None;
    for (i, (name, RigCamera { camera, cam_from_rig, .. })) in calibrated(calibration).enumerate() {
        let Some((_, projection, distortion, intrinsics, coefficients)) = lens_of(&camera.model) else {
            let (camera, what) = (name.to_owned(), format!("lens model {}", camera.model));
            return Err(Error::CannotCarry { format: "kalibr", camera, what, instead: Vec::new() });
        };
        let list = |places: &[usize]| numbers(places.iter().map(|&place| camera.params[place]));
        let [width, height] = camera.image_size;
        text.push_str(&format!(
            "cam{i}:\n  camera_model: {projection}\n  intrinsics: {}\n  distortion_model: {distortion}\n  \
             distortion_coeffs: {}\n  resolution: [{width}, {height}]\n  rostopic: /{}/image_raw\n",
            list(intrinsics),
            list(coefficients),
            topics[i]
        ));
        if let Some(before) = before {
            let pose = *cam_from_rig * before.inverse();
            let rotation = pose.rotation_matrix();
            text.push_str("  T_cn_cnm1:\n");
            for row in 0..3 {
                let cells = (0..3).map(|column| rotation[(row, column)]).chain([pose.translation[row]]);
                text.push_str(&format!("  - {}\n", numbers(cells)));
            }
            text.push_str("  - [0., 0., 0., 1.]\n");
        }
        before = Some(*cam_from_rig);
    }
    Ok(vec![OutputFile { name: "camchain.yaml".to_owned(), bytes: text.into_bytes() }])
}

fn numbers(values: impl Iterator<Item = f64>) -> String {
    format!("[{}]", values.map(yaml_number).collect::<Vec<String>>().join(", "))
}

pub(crate) fn read_cameras(file: &str, bytes: &[u8]) -> Result<Vec<NamedCamera>, Error> {
    let root = read_file_storage(file, bytes)?;
    let mut cameras: Vec<NamedCamera> = Vec::new();
    while let Some(node) = root.get(&format!("cam{}", cameras.len())) {
        let chain = Chain { file, key: format!("cam{}", cameras.len()), node };
        let name = chain.name();
        if cameras.iter().any(|other| other.name == name) {
            return Err(chain.bad(node, "rostopic", name, "each camera has a topic of its own"));
        }
        let camera = chain.camera(&name)?;
        let before = cameras.last().map(|before| before.cam_from_rig);
        // Without a pose anywhere in the chain, what follows hangs in the air.
        let cam_from_rig = match before {
            None => Some(Pose::identity()),
            Some(before) => chain.pose()?.zip(before).map(|(pose, before)| pose * before),
        };
        cameras.push(NamedCamera { name, camera, cam_from_rig, covariance: None });
    }
    let need = "a camchain has cam0, cam1 and so on, each with camera_model and intrinsics";
    // A camera after a gap would be lost without a word.
    let is_beyond = |(key, _): &&(String, Node)| number_of(key).is_some_and(|number| number > cameras.len());
    if let Value::Map(entries) = &root.value
        && let Some((key, node)) = entries.iter().find(is_beyond)
    {
        let found = format!("there is {key}, but no cam{}", cameras.len());
        return Err(Error::Malformed { place: Place::line(file, node.line), found, need });
    }
    if cameras.is_empty() {
        let found = "the file has no camera".to_owned();
        return Err(Error::Malformed { place: Place::file(file), found, need });
    }
    Ok(cameras)
}

/// Returns the number of a camera in the chain, of its key.
fn number_of(key: &str) -> Option<usize> {
    key.strip_prefix("cam")?.parse().ok()
}

/// A camera of the chain.
struct Chain<'a> {
    file: &'a str,
    key: String,
    node: &'a Node,
}

impl Chain<'_> {
    fn bad(&self, node: &Node, key: &str, value: String, need: &str) -> Error {
        let place = Place::line(self.file, node.line);
        Error::BadValue { place, column: format!("{}.{key}", self.key), value, need: need.to_owned() }
    }

    fn missing(&self, key: &str) -> Error {
        self.bad(self.node, key, "missing".to_owned(), "a camera has camera_model, intrinsics and resolution")
    }

    /// Returns the topic's part that tells the camera, or its place in the chain.
    fn name(&self) -> String {
        let topic = self.node.get("rostopic").and_then(Node::text).unwrap_or_default();
        let name = topic.trim_matches('/').trim_end_matches("image_raw").trim_matches('/');
        if name.is_empty() { self.key.clone() } else { name.to_owned() }
    }

    fn list(&self, node: &Node, key: &str) -> Result<Vec<f64>, Error> {
        let need = "it must be a list of finite numbers";
        let Value::List(items) = &node.value else {
            return Err(self.bad(node, key, node.text().unwrap_or("no list").to_owned(), need));
        };
        let number = |item: &Node| item.number().filter(|number| number.is_finite());
        let found: Option<Vec<f64>> = items.iter().map(number).collect();
        found.ok_or_else(|| self.bad(node, key, "something else".to_owned(), need))
    }

    fn camera(&self, name: &str) -> Result<Camera, Error> {
        let word = |key: &str| self.node.get(key).and_then(Node::text);
        let projection = word("camera_model").ok_or_else(|| self.missing("camera_model"))?;
        let coefficients = match self.node.get("distortion_coeffs") {
            None => Vec::new(),
            Some(node) => self.list(node, "distortion_coeffs")?,
        };
        let distortion = match word("distortion_model") {
            // Some of Kalibr's own programs shorten the word.
            Some("equi") => "equidistant",
            Some(word) => word,
            None => "none",
        };
        let wanted = |(_, p, d, ..): &&Lens| (*p, *d) == (projection, distortion);
        let (ours, _, _, places, distortion_places) = LENSES.iter().find(wanted).ok_or_else(|| {
            let known: Vec<String> = LENSES.iter().map(|(_, p, d, ..)| format!("{p}-{d}")).collect();
            let need = format!("these are read: {}", known.join(", "));
            self.bad(self.node, "camera_model", format!("{projection}-{distortion}"), &need)
        })?;
        let node = self.node.get("intrinsics").ok_or_else(|| self.missing("intrinsics"))?;
        let intrinsics = self.list(node, "intrinsics")?;
        for (key, found, need) in [
            ("intrinsics", intrinsics.len(), places.len()),
            ("distortion_coeffs", coefficients.len(), distortion_places.len()),
        ] {
            if found != need {
                let need = format!("{projection}-{distortion} has {need} of them");
                return Err(self.bad(self.node, key, format!("{found} numbers"), &need));
            }
        }
        let mut params = vec![0.0; places.len() + distortion_places.len()];
        for (&place, value) in
            places.iter().chain(*distortion_places).zip(intrinsics.iter().chain(&coefficients))
        {
            params[place] = *value;
        }
        let node = self.node.get("resolution").ok_or_else(|| self.missing("resolution"))?;
        let size = self.list(node, "resolution")?;
        let is_size = |size: &&[f64]| size.iter().all(|n| n.fract() == 0.0 && (1.0..=1e6).contains(n));
        let Some(&[width, height]) = Some(&size[..]).filter(is_size) else {
            return Err(self.bad(
                node,
                "resolution",
                format!("{size:?}"),
                "it must be [width, height] in pixels",
            ));
        };
        let lens = |source| Error::Lens {
            place: Place::line(self.file, self.node.line),
            camera: name.to_owned(),
            source: Box::new(source),
        };
        let model: Model = ours.parse().map_err(lens)?;
        Camera::new(model, params, [width as u32, height as u32]).map_err(lens)
    }

    /// Returns the pose relative to the camera before, where the file has one.
    fn pose(&self) -> Result<Option<Pose>, Error> {
        let Some(node) = self.node.get("T_cn_cnm1") else { return Ok(None) };
        let need = "it must be a 4x4 matrix: a rotation, a translation in metres, and 0 0 0 1";
        let Value::List(rows) = &node.value else {
            return Err(self.bad(node, "T_cn_cnm1", "no list".to_owned(), need));
        };
        let rows = rows.iter().map(|row| self.list(row, "T_cn_cnm1")).collect::<Result<Vec<_>, _>>()?;
        let all: Vec<f64> = rows.iter().flatten().copied().collect();
        let is_square = rows.len() == 4 && rows.iter().all(|row| row.len() == 4);
        let matrix = Matrix3::from_fn(|row, column| all.get(4 * row + column).copied().unwrap_or(f64::NAN));
        let excess = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
        let is_rotation = excess < ORTHONORMAL && matrix.determinant() > 0.0;
        if !is_square || !is_rotation || all[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.bad(node, "T_cn_cnm1", format!("{all:?}"), need));
        }
        Ok(Some(Pose::from_matrix(&matrix, Vector3::new(all[3], all[7], all[11]))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::{calibration, lens, rig};

    fn chain() -> String {
        let cameras = rig(&[("opencv4", lens(4)), ("mei", lens(5)), ("kannala-brandt4", lens(4))]);
        String::from_utf8(export(&calibration(cameras)).unwrap().remove(0).bytes).unwrap()
    }

    #[test]
    fn a_rig_is_a_chain() {
        let cameras = rig(&[("opencv4", lens(4)), ("mei", lens(5)), ("kannala-brandt4", lens(4))]);
        let read = read_cameras("c.yaml", chain().as_bytes()).unwrap();
        for (read, written) in read.iter().zip(cameras.iter().flatten()) {
            assert_eq!(read.camera, written.camera);
            let apart = read.cam_from_rig.unwrap() * written.cam_from_rig.inverse();
            assert!(apart.log().norm() < 1e-14);
        }
        assert_eq!([&read[0].name, &read[1].name, &read[2].name], ["left", "right", "cam2"]);
    }

    #[test]
    fn names_that_topics_cannot_bear_stay_apart() {
        let mut calibration = calibration(rig(&[("opencv4", lens(4)), ("opencv4", lens(4))]));
        for (fit, name) in calibration.cameras.iter_mut().zip(["/rig/a b", "rig/a_b"]) {
            fit.name = name.to_owned();
        }
        let read = read_cameras("c.yaml", &export(&calibration).unwrap()[0].bytes).unwrap();
        assert_eq!([&read[0].name, &read[1].name], ["rig/a_b", "rig/a_b-2"]);
    }

    /// The example of Kalibr's wiki page "Yaml formats", its numbers shortened.
    #[test]
    fn the_published_example_is_read() {
        let text = "cam0:\n  camera_model: pinhole\n  intrinsics: [461.6, 460.1, 362.6, 246.0]\n  \
             distortion_model: radtan\n  distortion_coeffs: [-0.27, 0.06, 0.0008, 0.0001]\n  T_cam_imu:\n  \
             - [0.01, 0.99, -0.01, 0.07]\n  - [-0.99, 0.01, 0.008, -0.01]\n  - [0.008, 0.01, 0.99, 0.003]\n  \
             - [0.0, 0.0, 0.0, 1.0]\n  timeshift_cam_imu: -8.121e-05\n  rostopic: /cam0/image_raw\n  \
             resolution: [752, 480]\ncam1:\n  camera_model: omni\n  intrinsics: [0.8, 833.0, 830.3, 373.8, 253.7]\n  \
             distortion_model: radtan\n  distortion_coeffs: [-0.33, 0.13, 0.0005, 0.0005]\n  T_cn_cnm1:\n  \
             - [1, 0, 0, -0.11]\n  - [0, 1, 0, 0.0004]\n  - [0, 0, 1, -0.0006]\n  - [0.0, 0.0, 0.0, 1.0]\n  \
             rostopic: /cam1/image_raw\n  resolution: [752, 480]\n";
        assert!(recognizes(text.as_bytes()));
        let read = read_cameras("c.yaml", text.as_bytes()).unwrap();
        assert_eq!(read[0].camera.params, [461.6, 460.1, 362.6, 246.0, -0.27, 0.06, 0.0008, 0.0001]);
        assert_eq!(read[1].camera.params[..6], [833.0, 830.3, 373.8, 253.7, 0.8, -0.33]);
        assert_eq!(read[1].cam_from_rig.unwrap().translation.x, -0.11);
    }

    #[test]
    fn what_is_wrong_is_said_with_line_and_value() {
        let good = chain();
        for (from, to, part) in [
            ("pinhole", "pinhol", "cam0.camera_model is `pinhol-radtan`"),
            ("radtan", "fov", "pinhole-fov"),
            ("[640, 480]", "[640]", "cam0.resolution"),
            ("  resolution: [640, 480]\n", "", "cam0.resolution is `missing`"),
            ("/right/", "/left/", "a topic of its own"),
            ("- [0., 0., 0., 1.]", "- [0., 0., 1.]", "cam1.T_cn_cnm1"),
            ("cam0:", "camera:", "there is cam1, but no cam0"),
            ("cam1:", "cam3:", "there is cam3, but no cam1"),
            ("  intrinsics: [", "  intrinsics: [1., ", "5 numbers"),
        ] {
            assert!(good.contains(from), "{from}");
            let error =
                read_cameras("c.yaml", good.replacen(from, to, 1).as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with("c.yaml:") && error.contains(part), "`{part}` is not in: {error}");
        }
        let error = read_cameras("c.yaml", b"camera: 1\n").unwrap_err().to_string();
        assert!(error.contains("the file has no camera"), "{error}");
    }
}
