//! The format plug: one line per file format, and reading a camera whatever file it is in.

use std::path::Path;

use boresight_camera::{Camera, Model};
use boresight_data::{Calibration, RigCamera, Target};
use boresight_geometry::Pose;

use crate::error::closest;
use crate::job::read;
use crate::seen::SeenFile;
use crate::{
    Error, calibration_json, cameramodel, corners_csv, corners_vnl, foxglove_mcap, h_matrix, kalibr,
    opencv_yaml, ros_camera_info, write_atomically,
};

/// A file format: what can be read from it and written to it.
pub struct Format {
    /// The name on the command line.
    pub name: &'static str,
    /// What it is, in a few words.
    pub about: &'static str,
    /// The endings of its files' names.
    pub extensions: &'static [&'static str],
    /// Tells from its bytes whether a file is a calibration in this format.
    pub(crate) recognizes: fn(&[u8]) -> bool,
    /// Reads cameras from a file, which is named in errors.
    pub(crate) read_cameras: Option<ReadCameras>,
    /// Reads corners of a target; the number is the base sigma in pixels.
    pub(crate) read_corners: Option<ReadCorners>,
    /// Writes a calibration.
    pub(crate) export: Option<Export>,
    /// Tells whether it can say what a lens model says.
    pub(crate) carries: fn(&Model) -> bool,
    /// Whether it says when the rows of an image were taken.
    pub(crate) has_times: bool,
}

type ReadCameras = fn(&str, &[u8]) -> Result<Vec<NamedCamera>, Error>;
type ReadCorners = fn(&str, &[u8], &Target, f64) -> Result<SeenFile, Error>;
type Export = fn(&Calibration) -> Result<Vec<OutputFile>, Error>;

const NONE: Format = Format {
    name: "",
    about: "",
    extensions: &[],
    recognizes: |_| false,
    read_cameras: None,
    read_corners: None,
    export: None,
    carries: |_| true,
    has_times: false,
};

/// All formats.
#[rustfmt::skip]
pub const FORMATS: &[Format] = &[
    Format { name: "json", about: "Boresight's own calibration.json, lossless", extensions: &["json"], recognizes: calibration_json::recognizes, read_cameras: Some(calibration_json::read_cameras), export: Some(calibration_json::export), has_times: true, ..NONE },
    Format { name: "opencv", about: "OpenCV FileStorage YAML, as calibration.cpp and stereo_calib.cpp write it", extensions: &["yml", "yaml"], recognizes: opencv_yaml::recognizes, read_cameras: Some(opencv_yaml::read_cameras), export: Some(opencv_yaml::export), carries: opencv_yaml::carries, ..NONE },
    Format { name: "cameramodel", about: "mrcal .cameramodel, one file per camera", extensions: &["cameramodel"], recognizes: cameramodel::recognizes, read_cameras: Some(cameramodel::read_cameras), export: Some(cameramodel::export), carries: cameramodel::carries, ..NONE },
    Format { name: "kalibr", about: "Kalibr camchain.yaml: pinhole-radtan, pinhole-equi, omni-radtan, ds and eucm", extensions: &["yaml"], recognizes: kalibr::recognizes, read_cameras: Some(kalibr::read_cameras), export: Some(kalibr::export), carries: kalibr::carries, ..NONE },
    Format { name: "ros", about: "ROS camera_info YAML, one file per camera, without its pose", extensions: &["yaml"], export: Some(ros_camera_info::export), carries: ros_camera_info::carries, ..NONE },
    Format { name: "h-matrix", about: "the matrices P, M and H = P M as text", extensions: &["txt"], export: Some(h_matrix::export_text), ..NONE },
    Format { name: "h-matrix-json", about: "the matrices P, M and H = P M as JSON", extensions: &["json"], export: Some(h_matrix::export_json), ..NONE },
    Format { name: "h-matrix-npy", about: "the matrices H as a NumPy array [camera, 3, 4]", extensions: &["npy"], export: Some(h_matrix::export_npy), ..NONE },
    Format { name: "mcap", about: "MCAP with Foxglove's CameraCalibration, FrameTransforms and ImageAnnotations, for viewers", extensions: &["mcap"], export: Some(foxglove_mcap::export), carries: foxglove_mcap::carries, ..NONE },
    Format { name: "csv", about: "corners as a table", extensions: &["csv"], read_corners: Some(corners_csv::read_csv), ..NONE },
    Format { name: "vnl", about: "corners as mrcal and mrgingham write them", extensions: &["vnl"], read_corners: Some(corners_vnl::read_vnl), ..NONE },
];

/// A camera read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Its name; that of the file where the file gives none.
    pub name: String,
    /// The lens. Its image size is `[0, 0]` where the file does not tell.
    pub camera: Camera,
    /// Where it sits relative to the file's reference, in metres; `None` where the file does not tell.
    pub cam_from_rig: Option<Pose>,
    /// How well it is known; `None` where the file does not tell.
    pub covariance: Option<NamedCovariance>,
}

/// The covariance of one camera's parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCovariance {
    /// The parameters' names without the camera's, such as `fx` or `cam_from_rig.tx_m`.
    pub names: Vec<String>,
    /// The covariance, row by row.
    pub values: Vec<f64>,
}

/// A file to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputFile {
    /// Its name within the folder of the output.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// Reads the cameras of a calibration file in any format that is read, told by its contents.
pub fn read_cameras(path: &Path) -> Result<Vec<NamedCamera>, Error> {
    cameras_from_bytes(&path.display().to_string(), &read(path)?)
}

/// Reads the cameras in the bytes of a calibration file; `file` is named in errors and tells its extension.
pub fn cameras_from_bytes(file: &str, bytes: &[u8]) -> Result<Vec<NamedCamera>, Error> {
    if bytes.trim_ascii().is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    let extension = Path::new(file).extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let readers = || FORMATS.iter().filter_map(|format| Some((format, format.read_cameras?)));
    let by_name = |format: &Format| extension.as_deref().is_some_and(|e| format.extensions.contains(&e));
    let found = readers().find(|(format, _)| (format.recognizes)(bytes));
    match found.or_else(|| readers().find(|(format, _)| by_name(format))) {
        Some((_, reader)) => reader(file, bytes),
        None => {
            let known = readers().map(|(format, _)| format.name).collect();
            Err(Error::Unrecognized { file: file.to_owned(), known })
        }
    }
}

/// Returns the files that hold a calibration in the format of this name.
pub fn export(calibration: &Calibration, format_name: &str) -> Result<Vec<OutputFile>, Error> {
    let exports = || FORMATS.iter().filter_map(|format| Some((format, format.export?)));
    let Some((format, export)) = exports().find(|(format, _)| format.name == format_name) else {
        let known = exports().map(|(format, _)| format.name).collect();
        return Err(Error::UnknownFormat { name: format_name.to_owned(), known });
    };
    for (name, RigCamera { camera, .. }) in calibrated(calibration) {
        if !(format.carries)(&camera.model) {
            let instead = exports().filter(|(f, _)| (f.carries)(&camera.model) && f.read_cameras.is_some());
            return Err(Error::CannotCarry {
                format: format.name,
                camera: name.to_owned(),
                what: format!("lens model {}", camera.model),
                instead: instead.map(|(format, _)| format.name).collect(),
            });
        }
        for (value, param) in camera.params.iter().zip(camera.model.param_names()) {
            if !value.is_finite() {
                return Err(Error::NotFinite { at: format!("{name}.{param}"), value: *value });
            }
        }
    }
    export(calibration)
}

/// Returns what a calibration says of its cameras and a format of this name has no place for, one line for each camera.
pub fn lost_in(calibration: &Calibration, format_name: &str) -> Vec<String> {
    let has_times = FORMATS.iter().any(|format| format.name == format_name && format.has_times);
    let timed = calibrated(calibration)
        .filter(|(_, placed)| !has_times && (placed.time_offset_s != 0.0 || placed.line_delay_s != 0.0));
    let line = |(name, placed): (&str, &RigCamera)| {
        format!(
            "{name}: format {format_name} has no place for its time offset of {:.3} ms and its line delay of {:.3} us; json has",
            1e3 * placed.time_offset_s,
            1e6 * placed.line_delay_s
        )
    };
    timed.map(line).collect()
}

/// Writes files into a folder, each whole or not at all.
pub fn write_files(folder: &Path, files: &[OutputFile]) -> Result<(), Error> {
    files.iter().try_for_each(|file| write_atomically(&folder.join(&file.name), &file.bytes))
}

/// Returns the name of the format that was most likely meant by a mistyped one.
pub fn closest_format(name: &str) -> Option<&'static str> {
    closest(name, FORMATS.iter().map(|format| format.name))
}

/// Returns the reader of corner files with this extension.
pub(crate) fn corner_reader(extension: &str) -> Option<ReadCorners> {
    FORMATS
        .iter()
        .filter(|format| format.extensions.contains(&extension))
        .find_map(|format| format.read_corners)
}

/// Returns the cameras that could be calibrated, with their names.
pub(crate) fn calibrated(calibration: &Calibration) -> impl Iterator<Item = (&str, &RigCamera)> {
    let cameras = calibration.cameras.iter().zip(&calibration.scene.rig.cameras);
    cameras.filter_map(|(fit, camera)| Some((fit.name.as_str(), camera.as_ref()?)))
}

/// Returns a distinct name for the file of each camera, of letters that every system takes.
pub(crate) fn file_stems<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    distinct(names, "-_.")
}

/// Returns a distinct name for each camera, of ASCII letters, digits and these others.
pub(crate) fn distinct<'a>(names: impl Iterator<Item = &'a str>, others: &str) -> Vec<String> {
    let mut taken: Vec<String> = Vec::new();
    for name in names {
        let safe: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() || others.contains(c) { c } else { '_' })
            .collect();
        let safe = if safe.trim_matches('.').is_empty() { "camera".to_owned() } else { safe };
        let mut one = safe.clone();
        let mut n = 2;
        while taken.contains(&one) {
            one = format!("{safe}-{n}");
            n += 1;
        }
        taken.push(one);
    }
    taken
}

/// Returns the name of a file without folder and extension.
pub(crate) fn stem_of(file: &str) -> String {
    Path::new(file).file_stem().map_or_else(|| file.to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// Tells whether `bytes` hold `word`.
pub(crate) fn holds(bytes: &[u8], word: &str) -> bool {
    bytes.windows(word.len()).any(|window| window == word.as_bytes())
}

#[cfg(test)]
#[path = "format_tests.rs"]
mod tests;
