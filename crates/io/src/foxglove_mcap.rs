//! Calibrations out as MCAP with Foxglove's JSON schemas, for viewers: what each camera is, where all of it is, and, where
//! the corners are at hand, what was detected.
//!
//! Frames of reference are named `rig`, the cameras' names, and the targets' names. Foxglove's pixels count from the corner
//! of the top-left pixel, ours from its centre, so that annotations are half a pixel further.

use std::collections::BTreeMap;
use std::path::Path;

use boresight_camera::{Camera, Model};
use boresight_data::{Calibration, FrameId, RigCamera};
use boresight_geometry::Pose;
use serde_json::{Value, json};

use crate::format::{OutputFile, calibrated};
use crate::recording::{Packing, RecordedValue, RecordingWriter};
use crate::{Error, ObservationRow};

/// The name of the file.
const FILE: &str = "calibration.mcap";
/// The time from frame to frame, where frames have no times.
const PERIOD_NS: i64 = 100_000_000;

/// Tells whether Foxglove has a name for a lens model.
pub(crate) fn carries(model: &Model) -> bool {
    distortion_of(model, &[]).is_some()
}

/// Returns Foxglove's name of a lens model, and how many of its coefficients are ours.
fn distortion_of(model: &Model, params: &[f64]) -> Option<(&'static str, Vec<f64>)> {
    let coefficients = params.get(4..).unwrap_or_default();
    let padded = |n: usize| {
        let mut padded = coefficients.to_vec();
        padded.resize(n, 0.0);
        padded
    };
    match model {
        Model::Pinhole(_) | Model::OpenCv4(_) | Model::OpenCv5(_) => Some(("plumb_bob", padded(5))),
        Model::OpenCv8(_) => Some(("rational_polynomial", padded(8))),
        Model::KannalaBrandt4(_) => Some(("kannala_brandt", padded(4))),
        _ => None,
    }
}

/// Returns the file of a calibration, without what was detected.
pub(crate) fn export(calibration: &Calibration) -> Result<Vec<OutputFile>, Error> {
    let bytes = calibration_to_mcap(calibration, &[])?;
    Ok(vec![OutputFile { name: FILE.to_owned(), bytes }])
}

/// Returns the bytes of a calibration as MCAP, with the corners it was made from, which may be none.
pub fn calibration_to_mcap(
    calibration: &Calibration,
    observations: &[ObservationRow],
) -> Result<Vec<u8>, Error> {
    let mut writer = RecordingWriter::new(Path::new(FILE), Vec::new(), Packing::Zstd)?;
    let mut write = |topic: &str, schema: &str, text: &Value, time_ns: i64, message: &Value| {
        let (schema_text, json) = (text.to_string(), message.to_string());
        let value =
            RecordedValue { topic, schema, schema_text: &schema_text, time_ns, json: json.as_bytes() };
        writer.json(&value)
    };
    let cameras: Vec<(&str, &RigCamera)> = calibrated(calibration).collect();
    for (name, RigCamera { camera, .. }) in &cameras {
        let Some(message) = camera_message(name, camera) else {
            return Err(Error::CannotCarry {
                format: "mcap",
                camera: (*name).to_owned(),
                what: format!("lens model {}", camera.model),
                instead: vec!["json"],
            });
        };
        let topic = format!("/{name}/calibration");
        write(&topic, "foxglove.CameraCalibration", &calibration_schema(), 0, &message)?;
    }
    // What does not move is told once, and again with each frame, so that a viewer knows it at any time.
    let mut still: Vec<(String, String, Pose)> = Vec::new();
    for (name, RigCamera { cam_from_rig, .. }) in &cameras {
        still.push(("rig".to_owned(), (*name).to_owned(), cam_from_rig.inverse()));
    }
    let targets: Vec<&str> = calibration.targets.iter().map(|target| target.name.as_str()).collect();
    let first = targets.first().copied().unwrap_or("target");
    for (name, belief) in targets.iter().zip(&calibration.scene.targets).skip(1) {
        still.push((first.to_owned(), (*name).to_owned(), belief.first_from_target));
    }
    let schema = transforms_schema();
    write("/tf", "foxglove.FrameTransforms", &schema, 0, &transforms_message(0, &still))?;
    let time_of = |frame: FrameId| i64::from(frame.0) * PERIOD_NS;
    for (frame, rig_from_target) in calibration.scene.rig_from_target.enumerate() {
        let Some(pose) = rig_from_target else { continue };
        let mut transforms = still.clone();
        transforms.push(("rig".to_owned(), first.to_owned(), *pose));
        let message = transforms_message(time_of(frame), &transforms);
        write("/tf", "foxglove.FrameTransforms", &schema, time_of(frame), &message)?;
    }
    // The frames of corners are told by name.
    let times: BTreeMap<&str, i64> =
        (0_i64..).zip(&calibration.frame_names).map(|(i, name)| (name.as_str(), i * PERIOD_NS)).collect();
    let schema = annotations_schema();
    for rows in observations.chunk_by(|a, b| a.view == b.view) {
        let Some(row) = rows.first() else { continue };
        let time = times.get(row.frame.as_str()).copied().unwrap_or(0);
        let topic = format!("/{}/annotations", row.camera);
        write(&topic, "foxglove.ImageAnnotations", &schema, time, &annotations_message(time, rows))?;
    }
    writer.finish()
}

fn time(time_ns: i64) -> Value {
    json!({ "sec": time_ns.div_euclid(1_000_000_000), "nsec": time_ns.rem_euclid(1_000_000_000) })
}

/// Returns what a camera is, or `None` where Foxglove has no name for its lens.
fn camera_message(name: &str, camera: &Camera) -> Option<Value> {
    let (distortion_model, distortion) = distortion_of(&camera.model, &camera.params)?;
    let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| camera.params.get(i).copied().unwrap_or(0.0));
    Some(json!({
        "timestamp": time(0),
        "frame_id": name,
        "width": camera.image_size[0],
        "height": camera.image_size[1],
        "distortion_model": distortion_model,
        "D": distortion,
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }))
}

/// Returns poses of children in their parents.
fn transforms_message(time_ns: i64, poses: &[(String, String, Pose)]) -> Value {
    let transform = |(parent, child, parent_from_child): &(String, String, Pose)| {
        let [x, y, z]: [f64; 3] = parent_from_child.translation.into();
        let [qx, qy, qz, qw]: [f64; 4] = parent_from_child.rotation.coords.into();
        json!({
            "timestamp": time(time_ns),
            "parent_frame_id": parent,
            "child_frame_id": child,
            "translation": { "x": x, "y": y, "z": z },
            "rotation": { "x": qx, "y": qy, "z": qz, "w": qw },
        })
    };
    json!({ "transforms": poses.iter().map(transform).collect::<Vec<Value>>() })
}

/// Returns the corners of a view: those that were used in green, others in red, and lines to where the solution has them,
/// a hundred times as long.
fn annotations_message(time_ns: i64, rows: &[ObservationRow]) -> Value {
    const MAGNIFIED: f64 = 100.0;
    let colour = |r: f64, g: f64, b: f64| json!({ "r": r, "g": g, "b": b, "a": 1.0 });
    let point = |pixel: [f64; 2]| json!({ "x": pixel[0] + 0.5, "y": pixel[1] + 0.5 });
    let points = |kind: u8, points: Vec<Value>, outline: Value| {
        json!({
            "timestamp": time(time_ns),
            "type": kind,
            "points": points,
            "outline_color": outline,
            "outline_colors": [],
            "fill_color": outline,
            "thickness": 2.0,
            "metadata": [],
        })
    };
    let of = |is_used: bool| {
        rows.iter().filter(move |row| row.reason.is_none() == is_used).map(|row| point(row.pixel)).collect()
    };
    let residual = |row: &ObservationRow| {
        let [du, dv] = row.residual_px?;
        let end = [row.pixel[0] + MAGNIFIED * du, row.pixel[1] + MAGNIFIED * dv];
        end.iter().all(|pixel| pixel.is_finite()).then(|| [point(row.pixel), point(end)])
    };
    // The numbers are Foxglove's for single points and for a list of lines.
    let mut annotations =
        vec![points(1, of(true), colour(0.1, 0.9, 0.2)), points(1, of(false), colour(1.0, 0.1, 0.1))];
    annotations.push(points(4, rows.iter().filter_map(residual).flatten().collect(), colour(1.0, 0.8, 0.0)));
    annotations.retain(|annotation| annotation["points"].as_array().is_some_and(|points| !points.is_empty()));
    json!({ "circles": [], "points": annotations, "texts": [] })
}

fn object(title: &str, properties: Value) -> Value {
    json!({ "title": title, "type": "object", "properties": properties })
}

fn time_schema() -> Value {
    object("time", json!({ "sec": { "type": "integer" }, "nsec": { "type": "integer" } }))
}

fn numbers() -> Value {
    json!({ "type": "array", "items": { "type": "number" } })
}

fn fields_schema(title: &str, names: &[&str]) -> Value {
    let fields = names.iter().map(|name| ((*name).to_owned(), json!({ "type": "number" })));
    object(title, Value::Object(fields.collect()))
}

fn calibration_schema() -> Value {
    object(
        "foxglove.CameraCalibration",
        json!({
            "timestamp": time_schema(),
            "frame_id": { "type": "string" },
            "width": { "type": "integer" },
            "height": { "type": "integer" },
            "distortion_model": { "type": "string" },
            "D": numbers(),
            "K": numbers(),
            "R": numbers(),
            "P": numbers(),
        }),
    )
}

fn transforms_schema() -> Value {
    let transform = object(
        "foxglove.FrameTransform",
        json!({
            "timestamp": time_schema(),
            "parent_frame_id": { "type": "string" },
            "child_frame_id": { "type": "string" },
            "translation": fields_schema("foxglove.Vector3", &["x", "y", "z"]),
            "rotation": fields_schema("foxglove.Quaternion", &["x", "y", "z", "w"]),
        }),
    );
    object("foxglove.FrameTransforms", json!({ "transforms": { "type": "array", "items": transform } }))
}

fn annotations_schema() -> Value {
    let colour = fields_schema("foxglove.Color", &["r", "g", "b", "a"]);
    let points = object(
        "foxglove.PointsAnnotation",
        json!({
            "timestamp": time_schema(),
            "type": { "type": "integer" },
            "points": { "type": "array", "items": fields_schema("foxglove.Point2", &["x", "y"]) },
            "outline_color": colour,
            "outline_colors": { "type": "array", "items": colour },
            "fill_color": colour,
            "thickness": { "type": "number" },
            "metadata": { "type": "array", "items": { "type": "object" } },
        }),
    );
    let any = json!({ "type": "array", "items": { "type": "object" } });
    object(
        "foxglove.ImageAnnotations",
        json!({ "circles": any, "points": { "type": "array", "items": points }, "texts": any }),
    )
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::ops::ControlFlow;

    use super::*;
    use crate::recording::read_recording_bytes;
    use crate::samples::{calibration, lens, rig};

    #[test]
    fn cameras_frames_and_corners_are_written_for_viewers() {
        let mut calibration = calibration(rig(&[("opencv5", lens(5)), ("kannala-brandt4", lens(4))]));
        calibration.targets = [crate::parse_target("chessboard:3x2:1cm").unwrap()].into_iter().collect();
        calibration.frame_names = vec!["a".to_owned(), "b".to_owned()];
        calibration.scene.rig_from_target = [None, Some(Pose::identity())].into_iter().collect();
        let row = |view, reason: Option<&str>| ObservationRow {
            view,
            camera: "left".to_owned(),
            frame: "b".to_owned(),
            target: "board".to_owned(),
            image: None,
            point: 0,
            pixel: [10.0, 20.0],
            sigma_px: 0.1,
            residual_px: Some([0.1, 0.0]),
            reason: reason.map(str::to_owned),
        };
        let rows = [row(0, None), row(0, Some("outlier")), row(1, None)];
        let bytes = calibration_to_mcap(&calibration, &rows).unwrap();
        assert_eq!(bytes, calibration_to_mcap(&calibration, &rows).unwrap());
        let contents = read_recording_bytes(Cursor::new(&bytes), &mut |_| ControlFlow::Continue(())).unwrap();
        let count =
            |name: &str| contents.topics.iter().find(|topic| topic.name == name).map(|topic| topic.messages);
        assert_eq!(
            ["/left/calibration", "/right/calibration", "/tf", "/left/annotations"].map(count),
            [Some(1), Some(1), Some(2), Some(2)]
        );
        let info = contents.topics[0].camera_info.clone().unwrap();
        assert_eq!((info.image_size, info.distortion_model.as_str()), ([640, 480], "plumb_bob"));
        assert_eq!(
            (info.intrinsics, &info.distortion[..]),
            ([0, 1, 2, 3].map(|i| lens(5)[i]), &lens(5)[4..])
        );
        assert_eq!(contents.topics[1].camera_info.clone().unwrap().distortion_model, "kannala_brandt");

        let message = annotations_message(0, &rows[..2]);
        assert_eq!(message["points"][0]["points"], json!([{ "x": 10.5, "y": 20.5 }]));
        assert_eq!(message["points"][2]["points"][1]["x"], json!(20.5));
    }

    #[test]
    fn lenses_that_foxglove_does_not_name_are_refused() {
        let calibration = calibration(rig(&[("eucm", lens(2))]));
        assert!(matches!(export(&calibration), Err(Error::CannotCarry { format: "mcap", .. })));
    }
}
