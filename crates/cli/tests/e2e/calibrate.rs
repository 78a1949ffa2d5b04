//! `calibrate`: the answer, the files, and that they are the same every time.

use serde_json::Value;

use crate::{boresight, dataset, json};

#[test]
fn the_recorded_pair_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    let run = boresight(folder.path(), &["calibrate", &dataset("opencv-stereo")]);
    let stderr = run.stderr.clone();
    let text = run.good();
    for part in
        ["left", "right", "baseline mm", "OpenCV's definition", "verdict: ", "out/calibration.json", "next: "]
    {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 110), "{text}");
    assert!(stderr.contains("done in"), "{stderr}");

    let calibration = json(&std::fs::read_to_string(folder.path().join("out/calibration.json")).unwrap());
    assert_eq!(calibration["schema"], "boresight.calibration/1");
    for key in ["rms_px", "cameras", "target", "stop", "provenance", "findings"] {
        assert!(!calibration[key].is_null(), "{key}");
    }
    for camera in calibration["cameras"].as_array().unwrap() {
        for key in [
            "name",
            "model",
            "image_size",
            "params",
            "cam_from_rig",
            "rms_px",
            "views",
            "observations",
            "rejected",
        ] {
            assert!(!camera[key].is_null(), "{key}");
        }
        assert!(camera["params"]["fx"]["sigma"].as_f64().unwrap() > 0.0);
    }
    assert_eq!(calibration["target"]["shape"].as_array().unwrap().len(), 2);
    assert_eq!(calibration["provenance"]["options"]["model"], "opencv5");
    // 3.327 squares of 25 mm, which mrcal and OpenCV agree on to 0.05 mm.
    let baseline_m = calibration["baselines_m"]["right"]["value"].as_f64().unwrap();
    assert!((baseline_m - 0.0832).abs() < 0.0003, "{baseline_m}");
}

#[test]
fn runs_and_threads_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["opencv-stereo", "rig4-synthetic"] {
        let runs = ["1", "1", "2"].map(|jobs| {
            let arguments = ["calibrate", &dataset(name), "--json", "--jobs", jobs];
            boresight(folder.path(), &arguments).good()
        });
        assert!(runs[0] == runs[1] && runs[0] == runs[2], "{name}");
        let file = std::fs::read_to_string(folder.path().join("out/calibration.json")).unwrap();
        assert_eq!(file, runs[0]);
        json(&file);
    }
}

#[test]
fn outliers_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let corners = dataset("opencv-stereo/corners-classic11.csv");
    let arguments = ["calibrate", &dataset("opencv-stereo"), &corners, "--json"];
    let dirty = json(&boresight(folder.path(), &arguments).good());
    let n_rejected: u64 =
        dirty["cameras"].as_array().unwrap().iter().map(|camera| camera["rejected"].as_u64().unwrap()).sum();
    // 26 gross outliers are in the file.
    assert!(n_rejected >= 24, "{n_rejected}");
    let clean = json(&boresight(folder.path(), &["calibrate", &dataset("opencv-stereo"), "--json"]).good());
    for i in 0..2 {
        let fx = |calibration: &Value| calibration["cameras"][i]["params"]["fx"]["value"].as_f64().unwrap();
        assert!((fx(&dirty) - fx(&clean)).abs() < 0.7, "{} {}", fx(&dirty), fx(&clean));
    }
}

#[test]
fn the_synthetic_rig_is_found_within_three_sigma() {
    let folder = tempfile::tempdir().unwrap();
    let found = json(
        &boresight(folder.path(), &["calibrate", &dataset("rig4-synthetic"), "--json", "--reject", "none"])
            .good(),
    );
    let truth = json(&std::fs::read_to_string(dataset("rig4-synthetic/truth.json")).unwrap());
    let mut worst: f64 = 0.0;
    for (camera, expected) in
        found["cameras"].as_array().unwrap().iter().zip(truth["cameras"].as_array().unwrap())
    {
        for (name, estimate) in camera["params"].as_object().unwrap() {
            let error = estimate["value"].as_f64().unwrap() - expected["params"][name].as_f64().unwrap();
            worst = worst.max(error.abs() / estimate["sigma"].as_f64().unwrap());
        }
        let pose = &camera["cam_from_rig"];
        let Some(sigmas) = pose["translation_sigma_m"].as_array() else { continue };
        for axis in 0..3 {
            let expected = expected["cam_from_rig"]["translation_m"][axis].as_f64().unwrap();
            let error = pose["translation_m"][axis].as_f64().unwrap() - expected;
            if sigmas[axis].as_f64().unwrap() > 0.0 {
                worst = worst.max(error.abs() / sigmas[axis].as_f64().unwrap());
            }
        }
    }
    assert!(worst > 0.0 && worst < 3.0, "{worst} sigma");
}

#[test]
fn flags_come_before_the_job_file() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "calibrate",
        &dataset("opencv-stereo"),
        "--json",
        "--cameras",
        "right",
        "--model",
        "opencv4",
        "--shape",
        "none",
    ];
    let calibration = json(&boresight(folder.path(), &arguments).good());
    assert_eq!(calibration["cameras"].as_array().unwrap().len(), 1);
    assert_eq!(calibration["cameras"][0]["model"], "opencv4");
    assert_eq!(calibration["target"]["shape"].as_array().unwrap().len(), 0);
    assert_eq!(calibration["provenance"]["options"]["cameras"], "right");
    let arguments = [
        "calibrate",
        &dataset("opencv-stereo/corners-classic5.csv"),
        "--json",
        "--target",
        "chessboard:9x6:25mm",
        "--image-size",
        "left=640x480",
        "--image-size",
        "right=640x480",
    ];
    boresight(folder.path(), &arguments).good();
}

#[test]
fn lenses_are_chosen_given_by_camera_believed_and_held() {
    let folder = tempfile::tempdir().unwrap();
    let stereo = dataset("opencv-stereo");
    let arguments = ["calibrate", &stereo, "--model", "auto,right=opencv4", "--shape", "auto", "--json"];
    let chosen = boresight(folder.path(), &arguments);
    let stderr = chosen.stderr.clone();
    for part in ["model[left]: ", "runner-up", "shape: views that took no part"] {
        assert!(stderr.contains(part), "`{part}` is not in: {stderr}");
    }
    assert!(!stderr.contains("model[right]"), "{stderr}");
    let chosen = json(&chosen.good());
    assert_eq!(chosen["cameras"][1]["model"], "opencv4");
    assert_eq!(chosen["provenance"]["options"]["model"], "auto,right=opencv4");
    let why = chosen["provenance"]["options"]["model.left"].as_str().unwrap();
    assert!(why.starts_with(chosen["cameras"][0]["model"].as_str().unwrap()), "{why}");

    let value = |calibration: &Value, camera: usize, param: &str| {
        calibration["cameras"][camera]["params"][param]["value"].as_f64().unwrap()
    };
    let arguments =
        ["calibrate", &stereo, "--prior", "out", "--hold", "lens:left,cx:right", "--json", "-o", "again"];
    let held = json(&boresight(folder.path(), &arguments).good());
    for param in ["fx", "cx"] {
        assert_eq!(value(&held, 0, param), value(&chosen, 0, param));
    }
    assert_eq!(value(&held, 1, "cx"), value(&chosen, 1, "cx"));
    assert!(value(&held, 1, "fx") != value(&chosen, 1, "fx"));
}
