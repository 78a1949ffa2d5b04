//! The commands to begin with: a target to print, a job file from data, and a demonstration.

use crate::{boresight, dataset};

#[test]
fn a_target_is_made_with_its_part_of_a_job() {
    let folder = tempfile::tempdir().unwrap();
    for (name, spec, paper) in [
        ("chessboard", "chessboard:9x6:25mm", "A4 landscape (297 x 210 mm)"),
        ("charuco", "charuco:8x6:30mm:22mm:5x5_1000", "A3 landscape"),
        ("tags", "aprilgrid:4x3:40mm:0.3:36h11", "A4 landscape"),
        ("dots", "acircles:4x11:20mm", "A4 portrait (210 x 297 mm)"),
    ] {
        let [drawing, part_of_job] = ["svg", "toml"].map(|kind| format!("prints/{name}.{kind}"));
        let run = boresight(folder.path(), &["target", "make", spec, "-o", &drawing]);
        let job = std::fs::read_to_string(folder.path().join(&part_of_job)).unwrap();
        assert!(job.ends_with(&format!("[target]\nkind = \"{spec}\"\n")), "{job}");
        for part in ["100 %", paper, &part_of_job, "mm from stroke to stroke"] {
            assert!(run.stderr.contains(part), "{part}: {}", run.stderr);
        }
        assert_eq!(run.good(), job);
        let svg = std::fs::read_to_string(folder.path().join(&drawing)).unwrap();
        assert!(svg.starts_with("<svg ") && svg.contains(spec) && svg.ends_with("</svg>\n"), "{spec}");
    }
    let run = boresight(folder.path(), &["target", "make", "chessboard:9x6:25mm", "--paper", "A3"]);
    assert!(run.stderr.contains("250 mm across, 175 mm down"), "{}", run.stderr);
    let svg = std::fs::read_to_string(folder.path().join("target.svg")).unwrap();
    assert!(svg.contains("width=\"420mm\" height=\"297mm\""), "{svg}");
    // The part of a job serves as a job.
    let corners = dataset("opencv-stereo/corners-classic5.csv");
    let arguments = ["info", &corners, "-c", "target.toml", "--image-size", "640x480"];
    let told = boresight(folder.path(), &arguments).good();
    assert!(told.contains("chessboard, 9x6 inner corners, 25 mm apart"), "{told}");
}

#[test]
fn targets_that_cannot_be_made_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, told) in [
        (&["chessboard:9x6:25"][..], "has no unit"),
        (&["chessboard:9x6:25mm", "-o", "board.pdf"], "end in .svg"),
        (
            &["chessboard:9x6:26mm", "--paper", "letter"],
            "needs 280 x 214 mm with its margins, and letter has",
        ),
        (&["chessboard:9x6:25mm", "--paper", "200x100mm"], "200 x 100 mm"),
        (&["chessboard:9x6:25mm", "--paper", "A9"], "A4, A3"),
        (&["chessboard:30x20:60mm"], "A0 has 841 x 1189 mm"),
        (&["chessboard:9x6:25mm", "--tag-border", "1"], "is for AprilGrids"),
    ] {
        let run = boresight(folder.path(), &[&["target", "make"], arguments].concat());
        assert_eq!(run.code, Some(2), "{arguments:?}: {}", run.stderr);
        assert!(run.stderr.contains(told), "{arguments:?}: {}", run.stderr);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_job_of_the_same_name_is_not_overwritten_by_a_target() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("boresight.toml"), "[target]\n").unwrap();
    let run = boresight(folder.path(), &["target", "make", "chessboard:9x6:25mm", "-o", "boresight.svg"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("boresight.toml is there already"), "{}", run.stderr);
    assert_eq!(std::fs::read_to_string(folder.path().join("boresight.toml")).unwrap(), "[target]\n");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    // Neither is what was measured.
    let make = ["target", "make", "chessboard:9x6:25mm", "-o", "board.svg"];
    boresight(folder.path(), &make).good();
    boresight(folder.path(), &make).good();
    let measured = "[target]\nkind = \"chessboard:9x6:24.8mm\"\n";
    std::fs::write(folder.path().join("board.toml"), measured).unwrap();
    assert_eq!(boresight(folder.path(), &make).code, Some(2));
    assert_eq!(std::fs::read_to_string(folder.path().join("board.toml")).unwrap(), measured);
}

#[test]
fn a_job_file_is_written_from_data() {
    let folder = tempfile::tempdir().unwrap();
    let corners = dataset("opencv-stereo/corners-classic5.csv");
    let arguments = ["init", &corners, "--target", "chessboard:9x6:25mm", "--image-size", "640x480"];
    let text = boresight(folder.path(), &arguments).good();
    for part in ["kind = \"chessboard:9x6:25mm\"", "name = \"left\"", "image_size = [640, 480]", "13 views"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let run = boresight(folder.path(), &["info", "."]);
    assert!(run.text().contains("26 views"), "{} {}", run.text(), run.stderr);
    let again = boresight(folder.path(), &arguments);
    assert_eq!(again.code, Some(2), "{}", again.stderr);
    assert!(again.stderr.contains("there already"), "{}", again.stderr);
}

#[test]
fn the_demonstration_finds_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let run = boresight(folder.path(), &["demo"]);
    for part in [
        "$ boresight calibrate demo -o demo/out",
        "verdict: ",
        "all 26 numbers together",
        "the noise explains it",
    ] {
        assert!(run.text().contains(part), "{part}: {}", run.text());
    }
    let text = run.good();
    let x = text.lines().find(|line| line.starts_with("right.x mm")).unwrap();
    // The right camera is 200 mm beside the left.
    let [truth_mm, estimate_mm] =
        [2, 3].map(|word| x.split_whitespace().nth(word).unwrap().parse::<f64>().unwrap());
    assert!((truth_mm - 200.0).abs() < 1.0 && (estimate_mm - truth_mm).abs() < 1.0, "{x}");
    let again = boresight(folder.path(), &["demo", "-o", "again"]).good();
    assert_eq!(text.replace("demo", "again"), again.replace("demo", "again"));
    // What it names as next.
    let compare = ["compare", "demo/out", "demo/truth", "--distance-m", "0.85", "--limit-px", "0.3"];
    boresight(folder.path(), &compare).good();
    assert_eq!(boresight(folder.path(), &["demo"]).code, Some(2));
    // Images of others stay.
    std::fs::create_dir(folder.path().join("images")).unwrap();
    let refused = boresight(folder.path(), &["demo", "-o", "."]);
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(refused.stderr.contains("images is there already"), "{}", refused.stderr);
}
