//! What is done with a calibration: matrices, exports, comparisons, projections.

use tempfile::TempDir;

use crate::{boresight, boresight_with_input, dataset, json};

fn calibrated() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    boresight(folder.path(), &["calibrate", &dataset("opencv-stereo")]).good();
    folder
}

#[test]
fn every_export_compares_equal() {
    let folder = calibrated();
    for (format, back) in [("json", "calibration.json"), ("opencv", "stereo.yml"), ("cameramodel", "")] {
        let listed = boresight(folder.path(), &["export", "out", "--to", format, "-o", format]).good();
        assert!(listed.lines().all(|file| folder.path().join(file).is_file()), "{listed}");
        let other = format!("{format}/{back}");
        let arguments = ["compare", "out", &other, "--json", "--limit-px", "1e-6"];
        let comparison = json(&boresight(folder.path(), &arguments).good());
        assert_eq!(comparison["cameras"].as_array().unwrap().len(), 2);
        assert!(comparison["pairs"][0]["translation_mm"].as_f64().unwrap() < 1e-6, "{format}");
    }
    for format in ["h-matrix", "h-matrix-json", "h-matrix-npy"] {
        boresight(folder.path(), &["export", "out", "--to", format, "-o", "h"]).good();
    }
    let run = boresight(folder.path(), &["export", "out", "--to", "opncv", "-o", "no"]);
    assert!(run.stderr.contains("known: json, opencv, cameramodel") && !folder.path().join("no").exists());
}

#[test]
fn a_comparison_holds_a_limit() {
    let folder = calibrated();
    let mrcal = dataset("opencv-stereo/reference/mrcal-classic5-left.cameramodel");
    let run = boresight(folder.path(), &["compare", "out", &mrcal, "--limit-px", "0.0001"]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.text().contains("above the limit of 0.0001 px"));
    boresight(folder.path(), &["compare", "out", &mrcal, "--distance-m", "1", "--limit-px", "5"]).good();
    assert_eq!(boresight(folder.path(), &["compare", "out", &mrcal, "--distance-m", "-1"]).code, Some(2));
}

#[test]
fn matrices_come_in_three_formats() {
    let folder = calibrated();
    let text = boresight(folder.path(), &["matrix", "out"]).good();
    assert!(text.contains("# H of right") && text.contains("u0 = "), "{text}");
    let document = json(&boresight(folder.path(), &["matrix", "out", "--format", "json"]).good());
    let run = boresight(folder.path(), &["matrix", "out/calibration.json", "--format", "npy"]);
    let npy = npyz::NpyFile::new(&run.stdout[..]).unwrap();
    assert_eq!(npy.shape(), [2, 3, 4]);
    let values: Vec<f64> = npy.into_vec().unwrap();
    assert_eq!(document["cameras"][1]["H"][2][3].as_f64(), Some(values[23]));
}

#[test]
fn points_survive_projection_and_back() {
    let folder = calibrated();
    for frame in ["camera", "rig"] {
        let flags = ["out", "--camera", "right", "--frame", frame];
        let project: Vec<&str> = ["project"].into_iter().chain(flags).collect();
        let pixels =
            boresight_with_input(folder.path(), &project, "1e9 5e8 4e9\n-1e9, 2e8, 5e9 # a comment\n").good();
        let unproject: Vec<&str> = ["unproject"].into_iter().chain(flags).collect();
        let directions = boresight_with_input(folder.path(), &unproject, &pixels).good();
        for (line, point) in directions.lines().zip([[1e9, 5e8, 4e9], [-1e9, 2e8, 5e9]]) {
            let length = point.iter().map(|x: &f64| x * x).sum::<f64>().sqrt();
            for (word, coordinate) in line.split(' ').zip(point) {
                // The points are so far away that where the camera sits does not matter.
                assert!((word.parse::<f64>().unwrap() - coordinate / length).abs() < 1e-9, "{line}");
            }
        }
    }
    let behind = boresight_with_input(folder.path(), &["project", "out", "--camera", "left"], "0 0 -1\n");
    assert_eq!(behind.text(), "nan nan\n");
    assert!(behind.stderr.contains("does not see 1"));
    let bad = boresight_with_input(folder.path(), &["project", "out", "--camera", "left"], "0 0 1\n0 x 1\n");
    assert_eq!(bad.code, Some(3));
    assert!(bad.stderr.contains("stdin:2: `x` is no finite number"), "{}", bad.stderr);
    let unnamed = boresight(folder.path(), &["project", "out"]);
    assert!(unnamed.code == Some(2) && unnamed.stderr.contains("hint: the cameras are left, right"));
}

#[test]
fn datasets_and_calibrations_tell_what_they_hold() {
    let folder = calibrated();
    let text = boresight(folder.path(), &["info", &dataset("opencv-stereo")]).good();
    assert!(text.contains("2 cameras, 13 frames, 26 views, 1404 corners"), "{text}");
    let text = boresight(folder.path(), &["info", "out"]).good();
    assert!(text.contains("corners-classic5.csv, blake3 ") && text.contains("verdict: "), "{text}");
    let text = boresight(folder.path(), &["info", &dataset("opencv-stereo/reference/left.yml")]).good();
    assert!(text.contains("opencv5, 640x480"), "{text}");
}

#[test]
fn the_rest_answers() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(boresight(folder.path(), &["completions", shell]).good().contains("calibrate"), "{shell}");
    }
    let codes = boresight(folder.path(), &["explain"]).good();
    for line in codes.lines() {
        let (code, meaning) = line.split_once(' ').unwrap();
        assert!(meaning.trim().len() > 20 && !meaning.contains("What it means"), "{line}");
        assert!(boresight(folder.path(), &["explain", code]).good().contains("How to fix it"), "{code}");
    }
    let unknown = boresight(folder.path(), &["explain", "few-view"]);
    assert!(unknown.code == Some(2) && unknown.stderr.contains("few-views"));
}
