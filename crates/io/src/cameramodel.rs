//! mrcal's `.cameramodel`: a Python literal with one camera's lens and pose.
//!
//! Both generations of keys are read, and both keys of the pose are written. The solve that mrcal
//! embeds (`optimization_inputs`) is skipped.

use boresight_camera::{Camera, Model};
use boresight_data::{Calibration, RigCamera};
use boresight_geometry::{Pose, Vector3};

use crate::format::{NamedCamera, OutputFile, calibrated, file_stems, holds, stem_of};
use crate::python_literal::{Literal, read_dict};
use crate::{Error, Place};

/// mrcal's names of lens models, and ours.
const MODELS: [(&str, &str); 9] = [
    ("LENSMODEL_PINHOLE", "pinhole"),
    ("LENSMODEL_OPENCV4", "opencv4"),
    ("LENSMODEL_OPENCV5", "opencv5"),
    ("LENSMODEL_OPENCV8", "opencv8"),
    ("LENSMODEL_OPENCV12", "opencv12"),
    ("LENSMODEL_STEREOGRAPHIC", "stereographic"),
    ("LENSMODEL_LONLAT", "lonlat"),
    ("LENSMODEL_LATLON", "latlon"),
    ("LENSMODEL_CAHVOR", "cahvor"),
];
/// What mrcal's names of lenses with a configuration begin with.
const CAHVORE: &str = "LENSMODEL_CAHVORE";
const SPLINED: &str = "LENSMODEL_SPLINED_STEREOGRAPHIC";
const MODEL_KEYS: [&str; 3] = ["lensmodel", "lens_model", "distortion_model"];
const POSE_KEYS: [&str; 2] = ["rt_cam_ref", "extrinsics"];
/// How far the two generations' poses may be apart: mrcal's own limit.
const POSE_TOLERANCE: f64 = 1e-9;

pub(crate) fn carries(model: &Model) -> bool {
    their_name(model).is_some()
}

/// Returns mrcal's name of a lens model, its configuration included.
fn their_name(model: &Model) -> Option<String> {
    let splined = |order: u8, [columns, rows]: [u16; 2], fov_x_deg: u16| {
        format!("{SPLINED}_order={order}_Nx={columns}_Ny={rows}_fov_x_deg={fov_x_deg}")
    };
    match model {
        Model::Splined2(lens) => Some(splined(2, lens.knots(), lens.fov_x_deg())),
        Model::Cahvore(lens) => Some(format!("{CAHVORE}_linearity={}", lens.linearity())),
        Model::Splined3(lens) => Some(splined(3, lens.knots(), lens.fov_x_deg())),
        _ => MODELS.iter().find(|(_, ours)| *ours == model.name()).map(|(theirs, _)| (*theirs).to_owned()),
    }
}

/// Returns the lens model of mrcal's name.
fn our_model(theirs: &str) -> Option<Model> {
    if let Some(configuration) = theirs.strip_prefix(CAHVORE) {
        let [linearity] = values_of(configuration, ["linearity"])?;
        return format!("cahvore:linearity={linearity}").parse().ok();
    }
    if let Some(configuration) = theirs.strip_prefix(SPLINED) {
        let [order, columns, rows, fov] = values_of(configuration, ["order", "Nx", "Ny", "fov_x_deg"])?;
        return format!("splined{order}:{columns}x{rows}:{fov}deg").parse().ok();
    }
    MODELS.iter().find(|(name, _)| *name == theirs).and_then(|(_, ours)| ours.parse().ok())
}

/// Returns the values of a configuration `_key=value_key=value` with exactly these keys, in this order.
fn values_of<'a, const N: usize>(mut configuration: &'a str, keys: [&str; N]) -> Option<[&'a str; N]> {
    let mut values = [""; N];
    for (i, key) in keys.iter().enumerate() {
        let rest = configuration.strip_prefix('_')?.strip_prefix(key)?.strip_prefix('=')?;
        let end = if i + 1 < N { rest.find('_')? } else { rest.len() };
        (values[i], configuration) = rest.split_at(end);
    }
    Some(values)
}

pub(crate) fn recognizes(bytes: &[u8]) -> bool {
    let quoted = |key: &str| holds(bytes, &format!("'{key}'")) || holds(bytes, &format!("\"{key}\""));
    MODEL_KEYS[..2].iter().any(|key| quoted(key)) || (quoted(MODEL_KEYS[2]) && quoted("intrinsics"))
}

/// Returns the files of a calibration: one for each camera, named after it.
pub(crate) fn export(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    let stems = file_stems(calibrated(calibration).map(|(name, _)| name));
    calibrated(calibration)
        .zip(stems)
        .map(|((name, rig_camera), stem)| {
            let bytes = write(name, rig_camera)?.into_bytes();
            Ok(OutputFile { name: format!("{stem}.cameramodel"), bytes })
        })
        .collect()
}

pub(crate) fn read_cameras(file: &str, bytes: &[u8]) -> Result<Vec<NamedCamera>, Error> {
    let entries = read_dict(file, bytes)?;
    let find = |keys: &[&str]| {
        keys.iter()
            .find_map(|key| entries.iter().find(|entry| entry.key == *key))
            .map(|entry| (entry.line, &entry.value))
    };
    let missing = |column: &str| Error::BadValue {
        place: Place::file(file),
        column: column.to_owned(),
        value: "missing".to_owned(),
        need: "a .cameramodel has lensmodel, intrinsics, imagersize, and extrinsics or rt_cam_ref".to_owned(),
    };
    let bad = |line: usize, column: &str, value: String, need: String| Error::BadValue {
        place: Place::line(file, line),
        column: column.to_owned(),
        value,
        need,
    };

    let (line, name) = find(&MODEL_KEYS).ok_or_else(|| missing("lensmodel"))?;
    let Literal::Text(name) = name else {
        return Err(bad(line, "lensmodel", name.describe(), "it must be a string".to_owned()));
    };
    let name = name.replacen("DISTORTION_", "LENSMODEL_", 1);
    let Some(model) = our_model(&name) else {
        let known: Vec<&str> = MODELS.iter().map(|(theirs, _)| *theirs).collect();
        let configured = format!("{CAHVORE}_linearity=0.37, {SPLINED}_order=3_Nx=30_Ny=18_fov_x_deg=120");
        let known = known.join(", ");
        return Err(bad(
            line,
            "lensmodel",
            name,
            format!("these are read: {known}, {configured} and the like"),
        ));
    };
    let camera_name = stem_of(file);
    let lens = |line: usize| {
        let camera = camera_name.clone();
        move |source| Error::Lens { place: Place::line(file, line), camera, source: Box::new(source) }
    };

    let (size_line, size) = find(&["imagersize"]).ok_or_else(|| missing("imagersize"))?;
    let image_size =
        size.numbers::<2>().filter(|size| size.iter().all(|n| n.fract() == 0.0 && (1.0..=1e6).contains(n)));
    let image_size = image_size.ok_or_else(|| {
        bad(size_line, "imagersize", size.describe(), "it must be [width, height] in pixels".to_owned())
    })?;
    let (line, intrinsics) = find(&["intrinsics"]).ok_or_else(|| missing("intrinsics"))?;
    let Some(params) = intrinsics.all_numbers() else {
        return Err(bad(
            line,
            "intrinsics",
            intrinsics.describe(),
            "it must be a list of numbers".to_owned(),
        ));
    };
    let camera = Camera::new(model, params, image_size.map(|n| n as u32)).map_err(lens(line))?;

    let mut poses: Vec<[f64; 6]> = Vec::new();
    for key in POSE_KEYS {
        let Some((line, value)) = find(&[key]) else { continue };
        let pose = value.numbers::<6>().filter(|pose| pose.iter().all(|value| value.abs() < 1e12));
        let need = "it must be six numbers: a Rodrigues vector and a translation";
        let pose = pose.ok_or_else(|| bad(line, key, value.describe(), need.to_owned()))?;
        if let Some(other) = poses.first()
            && pose.iter().zip(other).any(|(a, b)| (a - b).abs() > POSE_TOLERANCE)
        {
            let need = format!("it must be equal to {} within {POSE_TOLERANCE}", POSE_KEYS[0]);
            return Err(bad(line, key, value.describe(), need));
        }
        poses.push(pose);
    }
    let [rx, ry, rz, tx, ty, tz] = *poses.first().ok_or_else(|| missing("extrinsics"))?;
    let cam_from_rig = Pose::from_rodrigues(Vector3::new(rx, ry, rz), Vector3::new(tx, ty, tz));
    Ok(vec![NamedCamera { name: camera_name, camera, cam_from_rig: Some(cam_from_rig), covariance: None }])
}

fn write(name: &str, RigCamera { camera, cam_from_rig, .. }: &RigCamera) -> Result<String, Error> {
    let Some(theirs) = their_name(&camera.model) else {
        let (camera, what) = (name.to_owned(), format!("lens model {}", camera.model));
        return Err(Error::CannotCarry { format: "cameramodel", camera, what, instead: Vec::new() });
    };
    // The shortest text that reads back as the same double, as Python's own; mrcal itself keeps 10 digits.
    let list =
        |values: &[f64]| values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", ");
    let [r, t]: [[f64; 3]; 2] = [cam_from_rig.rodrigues().into(), cam_from_rig.translation.into()];
    let pose = list(&[r, t].concat());
    let [width, height] = camera.image_size;
    let comment = name.replace(char::is_control, " ");
    Ok(format!(
        "# camera {comment}, written by Boresight {version}\n\
         {{\n    'lensmodel':  '{theirs}',\n\n    \
         # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n    \
         'intrinsics': [ {intrinsics}, ],\n\n    \
         # the pose of the camera, cam_from_ref: a Rodrigues vector and a translation in metres;\n    \
         # extrinsics is the name that mrcal up to 2.4 reads\n    \
         'rt_cam_ref': [ {pose}, ],\n    'extrinsics': [ {pose}, ],\n\n    \
         'imagersize': [ {width}, {height}, ],\n}}\n",
        version = env!("CARGO_PKG_VERSION"),
        intrinsics = list(&camera.params),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: &str = "# made by hand { 'lensmodel': 1 }\n{\n    'distortion_model':  b\"DISTORTION_OPENCV4',\n\
        'intrinsics': ( 1e3, 1000., 640, .5, -1.5e-1, 2E+0, 0, -0.0, ), # a comment\n\
        'valid_intrinsics_region': [ [ 88, 0 ],\n [ 88, 44 ],\n],\n\
        'extrinsics': [ 0, 0, 0.1, 1, 2, 3,],\n 'imagersize': [ 1280, 800,],\n 'icam_intrinsics': 1,\n\
        'optimization_inputs': b'P)h>@EdT%j2{}[]',\n}\n";

    fn refuses(from: &str, to: &str, parts: &[&str]) {
        assert!(OLD.contains(from), "{from}");
        let error =
            read_cameras("a/c.cameramodel", OLD.replace(from, to).as_bytes()).unwrap_err().to_string();
        for part in parts {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }

    #[test]
    fn the_old_generation_is_read() {
        assert!(recognizes(OLD.as_bytes()));
        let cameras = read_cameras("a/c.cameramodel", OLD.as_bytes()).unwrap();
        assert_eq!(cameras[0].name, "c");
        assert_eq!(cameras[0].camera.model.name(), "opencv4");
        assert_eq!(cameras[0].camera.params, [1000.0, 1000.0, 640.0, 0.5, -0.15, 2.0, 0.0, 0.0]);
        assert_eq!(cameras[0].camera.image_size, [1280, 800]);
        let pose = Pose::from_rodrigues(Vector3::new(0.0, 0.0, 0.1), Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(cameras[0].cam_from_rig, Some(pose));
    }

    #[test]
    fn what_is_wrong_is_said_with_line_and_value() {
        refuses(
            "DISTORTION_OPENCV4",
            "LENSMODEL_KANNALA",
            &["a/c.cameramodel:3", "LENSMODEL_KANNALA", "LENSMODEL_OPENCV8"],
        );
        refuses(
            "DISTORTION_OPENCV4",
            "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_fov_x_deg=9",
            &["Ny=18"],
        );
        refuses(
            "DISTORTION_OPENCV4",
            "LENSMODEL_SPLINED_STEREOGRAPHIC_order=4_Nx=9_Ny=9_fov_x_deg=9",
            &["order=3"],
        );
        refuses("1e3,", "", &["c.cameramodel:4", "8 parameters, 7 are given"]);
        refuses("1e3", "-1e3", &["fx", "-1000"]);
        refuses("1e3", "nan", &["c.cameramodel:4"]);
        refuses("1280", "1280.5", &["c.cameramodel:9", "imagersize is `[1280.5, 800]`"]);
        refuses("'imagersize'", "'imager'", &["imagersize is `missing`"]);
        refuses("'extrinsics'", "'other'", &["extrinsics is `missing`"]);
        refuses(
            "'icam_intrinsics': 1,",
            "'rt_cam_ref': [0,0,0.1,1,2,4],",
            &["extrinsics", "equal to rt_cam_ref"],
        );
        refuses("'icam_intrinsics': 1,", "'icam_intrinsics': 1", &["c.cameramodel:11"]);
    }

    #[test]
    fn reference_files_of_mrcal_are_read_where_present() {
        for (file, model) in [
            ("corners-stereo-drcal/raw/reference/camera-1.cameramodel", "opencv8"),
            ("corners-mrcal-figueroa/raw/pinhole-narrow-yawed-left.cameramodel", "pinhole"),
            ("stereo-opencv-left-right/derived/mrcal/OPENCV5-camera-1.cameramodel", "opencv5"),
            ("corners-mrcal-figueroa/raw/splined-0.cameramodel", "splined3"),
        ] {
            let Some(path) = crate::samples::shared_file(&format!("datasets/{file}")) else { continue };
            let bytes = std::fs::read(path).unwrap();
            assert!(recognizes(&bytes), "{file}");
            let found = read_cameras(file, &bytes);
            assert_eq!(found.unwrap()[0].camera.model.name(), model);
        }
    }
}
