//! From images: cameras found by the images' names, boards detected, and what is told where that fails.

use std::io::Write as _;
use std::path::Path;

use boresight::{Camera, Geometry, Model, Pose, Shape, Target, Vector3};
use boresight_data::GrayPixels;
use boresight_synthetic::{Exposure, render};

use crate::{boresight, json};

/// Photographs that the Debian package opencv-doc brings, and the sets kept beside the project.
const PHOTOGRAPHS: [&str; 2] = [
    "/usr/share/doc/opencv-doc/examples/data",
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/datasets/stereo-opencv-left-right/raw"),
];

#[test]
fn photographs_of_a_stereo_pair_are_calibrated() {
    let Some(source) = PHOTOGRAPHS.iter().map(Path::new).find(|path| path.join("left01.jpg").is_file())
    else {
        // Past the harness, which keeps to itself what passing tests print.
        let _ =
            writeln!(std::io::stderr(), "skipped: there are no photographs in {}", PHOTOGRAPHS.join(" or "));
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    for i in (1..=14).filter(|i| *i != 10) {
        for side in ["left", "right"] {
            let name = format!("{side}{i:02}.jpg");
            std::fs::copy(source.join(&name), folder.path().join("images").join(&name)).unwrap();
        }
    }
    let arguments = ["calibrate", "images", "--target", "chessboard:9x6:25mm", "--reject", "none", "--json"];
    let calibration = json(&boresight(folder.path(), &arguments).good());
    for camera in calibration["cameras"].as_array().unwrap() {
        assert_eq!((camera["views"].as_u64(), camera["observations"].as_u64()), (Some(13), Some(13 * 54)));
    }
    // The peers reach 0.2150 px at best, and agree on the baseline to 0.05 mm.
    let rms_px = calibration["rms_px"].as_f64().unwrap();
    assert!(rms_px <= 0.2150, "{rms_px}");
    let baseline_m = calibration["baselines_m"]["right"]["value"].as_f64().unwrap();
    assert!((baseline_m - 0.0832).abs() <= 0.0001, "{baseline_m}");
}

/// Writes images of a 7x5 board, and returns their folder.
fn rendered() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("cam")).unwrap();
    let params = vec![300.0, 300.0, 159.0, 121.0];
    let camera = Camera { model: Model::Pinhole(Default::default()), params, image_size: [320, 240] };
    let geometry = Geometry::Chessboard { columns: 7, rows: 5, spacing_m: 0.03 };
    let target = Target { name: "board".to_owned(), geometry, shape: Shape::Rigid };
    for i in 0..6u32 {
        let t = f64::from(i);
        let turn = Vector3::new(0.5 * (1.9 * t).cos(), 0.5 * (1.9 * t).sin(), 0.3 * (t - 2.0));
        let turned = Pose::from_rodrigues(turn, Vector3::zeros());
        let middle = Vector3::new(0.02 * (2.0 * t).sin(), 0.02 * t.cos(), 0.40 + 0.02 * t);
        let pose = Pose::new(turned.rotation, middle - turned * Vector3::new(0.09, 0.06, 0.0));
        let image = render(&camera, &pose, &target, &[], &Exposure::default(), u64::from(i)).unwrap();
        let GrayPixels::Eight(values) = image.pixels() else { panic!("eight bits are the default") };
        let mut pgm = b"P5\n320 240\n255\n".to_vec();
        pgm.extend(values);
        std::fs::write(folder.path().join(format!("cam/{i}.pgm")), pgm).unwrap();
    }
    folder
}

/// Writes images of a target into `NAME/`: three that show all of it, and six in which the border cuts it.
fn write_views(folder: &Path, name: &str, spec: &str) {
    let target = boresight::parse_target(spec).unwrap();
    let params = vec![620.0, 620.0, 319.0, 241.0];
    let camera = Camera { model: Model::Pinhole(Default::default()), params, image_size: [640, 480] };
    let last = target.drawn_point(boresight_data::PointId(target.point_count() as u32 - 1));
    // Of a grid of tags, z is towards the camera.
    let is_turned = matches!(target.geometry, Geometry::AprilGrid { .. });
    let front = Vector3::new(if is_turned { std::f64::consts::PI } else { 0.0 }, 0.0, 0.0);
    std::fs::create_dir(folder.join(name)).unwrap();
    for i in 0..9u32 {
        let t = f64::from(i);
        let aside = if i < 3 { 0.01 } else { 0.14 };
        let middle = Vector3::new(aside * (1.05 * t).cos(), aside * (1.05 * t).sin(), 0.52);
        let turn = Vector3::new(0.3 * (1.9 * t).cos(), 0.3 * (1.9 * t).sin(), 0.2 * (t - 2.0));
        let rotation = (Pose::from_rodrigues(turn, Vector3::zeros())
            * Pose::from_rodrigues(front, Vector3::zeros()))
        .rotation;
        let pose = Pose::new(rotation, middle - rotation * (0.5 * last));
        let image = render(&camera, &pose, &target, &[], &Exposure::default(), u64::from(i)).unwrap();
        let GrayPixels::Eight(values) = image.pixels() else { panic!("eight bits are the default") };
        let mut pgm = b"P5\n640 480\n255\n".to_vec();
        pgm.extend(values);
        std::fs::write(folder.join(name).join(format!("{i}.pgm")), pgm).unwrap();
    }
}

#[test]
fn targets_of_the_wrong_size_are_refused_with_the_right_one() {
    let folder = tempfile::tempdir().unwrap();
    for (i, (right, wrong)) in [
        ("chessboard:9x6:30mm", &["10x6", "8x6", "9x7", "9x5", "6x10", "11x8"][..]),
        ("charuco:8x6:30mm:22mm:4x4_50", &["9x6", "7x6", "8x5", "6x8"]),
        ("aprilgrid:4x3:60mm:0.3:36h11", &["5x3", "3x4", "4x2", "3x3"]),
        ("circles:7x5:30mm", &["8x5", "6x5", "7x6", "7x4"]),
        ("acircles:4x9:16mm", &["5x9", "3x9", "4x8", "4x10", "9x4"]),
    ]
    .into_iter()
    .enumerate()
    {
        let name = format!("cam{i}");
        write_views(folder.path(), &name, right);
        let run = boresight(folder.path(), &["detect", &name, "--target", right]);
        assert!(run.stdout.len() > 3000, "{right}: {}", run.stderr);
        let size = right.split(':').nth(1).unwrap();
        for other in wrong {
            let declared = right.replacen(size, other, 1);
            let run = boresight(folder.path(), &["detect", &name, "--target", &declared]);
            assert_eq!((run.code, run.stdout.len()), (Some(3), 0), "{declared}: {}", run.stderr);
            assert!(run.stderr.contains(&format!("--target {right}")), "{declared}: {}", run.stderr);
            // The table says of each image why it has no labels.
            assert!(run.stderr.lines().filter(|line| line.contains(".pgm")).count() == 9, "{}", run.stderr);
        }
    }
}

#[test]
fn spoilt_images_are_told_and_the_others_used() {
    let folder = rendered();
    let at = |name: &str| folder.path().join("cam").join(name);
    std::fs::copy(at("0.pgm"), at("7.pgm")).unwrap();
    std::fs::write(at("8.png"), b"no image").unwrap();
    std::fs::write(at("9.pgm"), b"P5\n2 2\n255\nabcd").unwrap();
    let run =
        boresight(folder.path(), &["detect", "cam", "--target", "chessboard:7x5:30mm", "-o", "corners.csv"]);
    for code in ["duplicate-images", "unreadable-image", "mixed-image-sizes"] {
        assert!(run.stderr.contains(code), "{code}: {}", run.stderr);
    }
    assert!(run.good().contains("7 of 9 images show the target"));
    let arguments = ["info", "corners.csv", "--target", "chessboard:7x5:30mm", "--image-size", "320x240"];
    assert!(boresight(folder.path(), &arguments).good().contains("210"));
    let run = boresight(
        folder.path(),
        &["calibrate", "cam/?.*", "--target", "chessboard:7x5:30mm", "--model", "pinhole"],
    );
    assert!(run.stderr.contains("unreadable-image"), "{}", run.stderr);
    assert!(run.text().contains("6 views"), "{}", run.text());
}

#[test]
fn a_board_of_another_size_is_named() {
    let folder = rendered();
    for target in ["chessboard:8x6:30mm", "chessboard:6x5:30mm"] {
        let run = boresight(folder.path(), &["calibrate", "cam", "--target", target]);
        assert_eq!(run.code, Some(3), "{}", run.stderr);
        assert!(run.stderr.contains("the board has 7x5 inner corners"), "{}", run.stderr);
        assert!(run.stderr.contains("--target chessboard:7x5:30mm"), "{}", run.stderr);
    }
    let run = boresight(folder.path(), &["calibrate", "cam"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("--target"), "{}", run.stderr);
    let run = boresight(folder.path(), &["detect", "cam/*.jpg", "--target", "chessboard:7x5:30mm"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    let sized = ["detect", "cam", "--target", "chessboard:7x5:30mm", "--image-size", "320x240"];
    let run = boresight(folder.path(), &sized);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("--image-size says nothing of images"), "{}", run.stderr);
    // A folder of images needs no job file for a robot either.
    let run = boresight(folder.path(), &["robot", "hand-eye", "cam", "--target", "chessboard:7x5:30mm"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("no table of robot poses"), "{}", run.stderr);
}

#[test]
fn mistakes_in_the_options_are_told_before_anything_is_detected() {
    let folder = rendered();
    let job = "[target]\nkind = \"chessboard:7x5:30mm\"\n[input]\nimages = [\"cam\"]\n[options]\nmodle = \"pinhole\"\n";
    std::fs::write(folder.path().join("boresight.toml"), job).unwrap();
    let run = boresight(folder.path(), &["calibrate", "boresight.toml"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("unknown field `modle`"), "{}", run.stderr);
    assert!(!run.stderr.contains("images in") && !folder.path().join("out").exists(), "{}", run.stderr);
}

#[test]
fn overlays_show_every_image() {
    let folder = rendered();
    let arguments = ["detect", "cam", "--target", "chessboard:7x5:30mm", "--overlays", "overlays"];
    let corners = boresight(folder.path(), &arguments).good();
    assert_eq!(corners.lines().count(), 1 + 6 * 35);
    assert_eq!(std::fs::read_dir(folder.path().join("overlays")).unwrap().count(), 6);
}
