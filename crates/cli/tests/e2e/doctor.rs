//! What is told of a recording before any solve.

use std::path::Path;

use crate::{boresight, dataset, json};

/// Makes the images of the demonstration.
fn demo(folder: &Path) {
    boresight(folder, &["demo", "-o", "recording"]).good();
    std::fs::remove_dir_all(folder.join("recording/out")).unwrap();
}

#[test]
fn images_are_examined_and_detections_remembered() {
    let folder = tempfile::tempdir().unwrap();
    demo(folder.path());
    let run = boresight(folder.path(), &["doctor", "recording"]);
    let text = run.text();
    assert_eq!(run.code, Some(0), "{text} {}", run.stderr);
    for part in ["weakest link of the rig: right shares 1", "nothing stands against calibrating this"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("caution["), "{text}");
    let again = boresight(folder.path(), &["doctor", "recording", "--json"]);
    assert!(again.stderr.contains("40 remembered"), "{}", again.stderr);
    let document = json(&again.good());
    assert_eq!(
        (&document["schema"], &document["is_usable"]),
        (&"boresight.examination/1".into(), &true.into())
    );
    let left = &document["cameras"][0];
    assert_eq!((left["name"].as_str(), left["image_size"][0].as_u64()), (Some("left"), Some(640)));
    let within = |key: &str, range: std::ops::Range<f64>| {
        let value = left[key].as_f64().unwrap();
        assert!(range.contains(&value), "{key} {value}");
    };
    within("coverage", 0.6..1.0);
    within("tilt_spread_deg", 30.0..90.0);
    within("largest_board", 0.3..1.0);
    within("sigma_px", 0.001..0.05);
}

#[test]
fn what_is_wrong_with_images_is_told_at_once() {
    let folder = tempfile::tempdir().unwrap();
    demo(folder.path());
    let images = folder.path().join("recording/images");
    std::fs::copy(images.join("left-00.png"), images.join("left-20.png")).unwrap();
    std::fs::write(images.join("right-20.png"), "no image").unwrap();
    let text = boresight(folder.path(), &["doctor", "recording"]).good();
    for part in ["unreadable-image]: right-20.png", "duplicate-images]: left-20.png", "the cautions above"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    // A file in the way is told before anything is detected.
    let refused = boresight(folder.path(), &["doctor", "recording", "-o", "recording/boresight.toml"]);
    assert_eq!(refused.code, Some(5), "{}", refused.stderr);
    assert!(refused.stderr.contains("it is a file, and results take a folder"), "{}", refused.stderr);
    // A board of another size is told, with the right one.
    let run = boresight(folder.path(), &["doctor", "recording", "--target", "chessboard:8x6:40mm"]);
    let told = format!("{}{}", run.text(), run.stderr);
    assert_eq!(run.code, Some(3), "{told}");
    assert!(told.contains("the board has 9x6 inner corners"), "{told}");
    assert!(told.contains("--target chessboard:9x6:40mm"), "{told}");
    // Two frames are no calibration.
    for (camera, i) in ["left", "right"].iter().flat_map(|camera| (2..21).map(move |i| (camera, i))) {
        std::fs::remove_file(images.join(format!("{camera}-{i:02}.png"))).unwrap();
    }
    let run = boresight(folder.path(), &["doctor", "recording"]);
    assert_eq!(run.code, Some(1), "{} {}", run.text(), run.stderr);
    for part in ["fail[no-start]", "fail[few-views]", "it should not be calibrated as it is"] {
        assert!(run.text().contains(part), "{part}: {}", run.text());
    }
}

#[test]
fn corners_are_examined_too() {
    let folder = tempfile::tempdir().unwrap();
    let text = boresight(folder.path(), &["doctor", &dataset("opencv-stereo")]).good();
    assert!(text.contains("right shares 13 frames with the others"), "{text}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "corners leave nothing behind");
}
