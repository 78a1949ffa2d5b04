//! From MCAP recordings: cameras are topics, frames are instants, and what is damaged is told.

use std::path::Path;

use boresight::{Camera, Geometry, Model, Pose, Shape, Target, Vector3};
use boresight_io::{Packing, RecordingWriter};
use boresight_synthetic::{Exposure, render};

use crate::{boresight, json};

const TARGET: &str = "chessboard:7x5:30mm";

/// Returns a recording of a 7x5 board that two cameras see, 80 mm apart, the second's images so much later.
fn recording(offset_ns: i64) -> Vec<u8> {
    let params = vec![300.0, 300.0, 159.0, 121.0];
    let camera = Camera { model: Model::Pinhole(Default::default()), params, image_size: [320, 240] };
    let geometry = Geometry::Chessboard { columns: 7, rows: 5, spacing_m: 0.03 };
    let target = Target { name: "board".to_owned(), geometry, shape: Shape::Rigid };
    let mut writer = RecordingWriter::new(Path::new("rendered"), Vec::new(), Packing::Zstd).unwrap();
    for i in 0..8_i64 {
        let t = i as f64;
        let turn = Vector3::new(0.5 * (1.9 * t).cos(), 0.5 * (1.9 * t).sin(), 0.2 * (t - 3.5));
        let turned = Pose::from_rodrigues(turn, Vector3::zeros());
        let middle = Vector3::new(0.04 + 0.02 * (2.0 * t).sin(), 0.02 * t.cos(), 0.50 + 0.02 * t);
        let rig_from_target = Pose::new(turned.rotation, middle - turned * Vector3::new(0.09, 0.06, 0.0));
        for (name, x_m) in [("left", 0.0), ("right", -0.08)] {
            let cam_from_rig = Pose::from_rodrigues(Vector3::zeros(), Vector3::new(x_m, 0.0, 0.0));
            let pose = cam_from_rig * rig_from_target;
            let image = render(&camera, &pose, &target, &[], &Exposure::default(), i as u64).unwrap();
            let late = if name == "right" { offset_ns } else { 0 };
            let stamp = 1_700_000_000_000_000_000 + i * 200_000_000 + late;
            writer.image(&format!("/drone/{name}/image_raw"), stamp, stamp + 4_000_000, &image).unwrap();
        }
    }
    writer.finish().unwrap()
}

fn folder(offset_ns: i64) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("drive.mcap"), recording(offset_ns)).unwrap();
    folder
}

#[test]
fn a_recording_is_calibrated_and_detections_are_remembered() {
    let folder = folder(1_000_000);
    let arguments = ["calibrate", "drive.mcap", "--target", TARGET, "--model", "pinhole", "--json"];
    let run = boresight(folder.path(), &arguments);
    assert!(run.stderr.contains("16 images in"), "{}", run.stderr);
    assert!(!run.stderr.contains("remembered"), "{}", run.stderr);
    let first = run.stdout.clone();
    let calibration = json(&run.text());
    let names: Vec<&str> = calibration["cameras"]
        .as_array()
        .unwrap()
        .iter()
        .map(|camera| camera["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["left", "right"]);
    let baseline_m = calibration["baselines_m"]["right"]["value"].as_f64().unwrap();
    assert!((baseline_m - 0.08).abs() < 1e-3, "{baseline_m}");

    let again = boresight(folder.path(), &arguments);
    assert!(again.stderr.contains("16 remembered"), "{}", again.stderr);
    assert_eq!(again.stdout, first);

    // A job file says the same, and `detect` gives corners that `calibrate` reads.
    let job = "[target]\nkind = \"chessboard\"\ncolumns = 7\nrows = 5\nspacing_m = 0.03\n\
        [input]\nrecordings = [\"drive.mcap\"]\nsync_tolerance_ms = 3.0\n";
    std::fs::write(folder.path().join("boresight.toml"), job).unwrap();
    let text = boresight(folder.path(), &["info", "."]).good();
    assert!(text.contains("16 views") || text.contains("8 frames"), "{text}");
    let arguments = ["detect", "drive.mcap", "--target", TARGET, "--overlays", "shown"];
    let corners = boresight(folder.path(), &arguments).good();
    assert_eq!(corners.lines().count(), 1 + 16 * 35);
    assert_eq!(std::fs::read_dir(folder.path().join("shown")).unwrap().count(), 16);
}

#[test]
fn cameras_that_are_apart_in_time_are_told_with_how_far() {
    let folder = folder(51_000_000);
    let run = boresight(folder.path(), &["info", "drive.mcap"]);
    assert!(run.stderr.contains("left and right are 51.00 ± 0.00 ms apart"), "{}", run.stderr);
    let text = run.good();
    for part in
        ["/drone/left/image_raw", "sensor_msgs/msg/Image", "320x240", "mono8", "5.00", "0 of 8 images"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
    let named = ["info", "drive.mcap", "--camera", "near=*/left/*", "--camera", "far=*/right/*"];
    let run = boresight(folder.path(), &named);
    assert!(run.stderr.contains("near and far are 51.00 ± 0.00 ms apart"), "{}", run.stderr);
    let arguments = ["detect", "drive.mcap", "--target", TARGET, "--sync-tolerance", "60ms"];
    let run = boresight(folder.path(), &arguments);
    assert!(!run.stderr.contains("cameras-apart-in-time"), "{}", run.stderr);
    let run = boresight(folder.path(), &["info", "drive.mcap", "--sync-tolerance", "60"]);
    assert_eq!(run.code, Some(2));
    assert!(run.stderr.contains("20ms"), "{}", run.stderr);
}

#[test]
fn damaged_and_foreign_recordings_are_told() {
    let folder = folder(0);
    let whole = std::fs::read(folder.path().join("drive.mcap")).unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("cut.mcap", &whole[..whole.len() * 2 / 3]);
    write("empty.mcap", b"");
    write("ros1.mcap", b"#ROSBAG V2.0\n");
    let nothing = RecordingWriter::new(Path::new("nothing"), Vec::new(), Packing::Zstd).unwrap();
    write("nothing.mcap", &nothing.finish().unwrap());
    let run = boresight(folder.path(), &["detect", "cut.mcap", "--target", TARGET]);
    assert!(run.stderr.contains("recording-cut-off"), "{}", run.stderr);
    assert!(run.good().lines().count() > 35);
    for (name, part) in
        [("empty.mcap", "empty"), ("ros1.mcap", "mcap convert"), ("nothing.mcap", "there are no images")]
    {
        let run = boresight(folder.path(), &["calibrate", name, "--target", TARGET]);
        assert_eq!(run.code, Some(3), "{name}: {}", run.stderr);
        assert!(run.stderr.contains(part), "{name}: {}", run.stderr);
    }
    let run = boresight(folder.path(), &["calibrate", "drive.mcap"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("--target"), "{}", run.stderr);
}
