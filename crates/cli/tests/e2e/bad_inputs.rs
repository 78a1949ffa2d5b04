//! Bad input: the exit code, a message with place, value and fix, and no trace in the output folder.

use std::path::Path;

use crate::{boresight, dataset};

fn job() -> String {
    std::fs::read_to_string(dataset("opencv-stereo/boresight.toml")).unwrap()
}

fn corners() -> String {
    std::fs::read_to_string(dataset("opencv-stereo/corners-classic5.csv")).unwrap()
}

/// Runs `calibrate job` on these files and checks how it fails.
fn fails(files: &[(&str, &str)], flags: &[&str], code: i32, parts: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("job")).unwrap();
    for (name, text) in files {
        std::fs::write(folder.path().join("job").join(name), text).unwrap();
    }
    let arguments: Vec<&str> = ["calibrate", "job"].iter().chain(flags).copied().collect();
    fails_with(folder.path(), &arguments, code, parts);
    assert!(!folder.path().join("out").exists(), "{parts:?}");
}

fn fails_with(folder: &Path, arguments: &[&str], code: i32, parts: &[&str]) {
    let run = boresight(folder, arguments);
    assert_eq!(run.code, Some(code), "{}", run.stderr);
    assert_eq!(run.stdout, b"", "{}", run.stderr);
    for part in parts {
        assert!(run.stderr.contains(part), "`{part}` is not in: {}", run.stderr);
    }
}

/// Runs on the recorded pair with one change in the job and one in the corners.
fn fails_changed(job_change: [&str; 2], corner_change: [&str; 2], code: i32, parts: &[&str]) {
    let (job, corners) = (job(), corners());
    assert!(job.contains(job_change[0]) && corners.contains(corner_change[0]), "{parts:?}");
    let job = job.replacen(job_change[0], job_change[1], 1);
    let corners = corners.replacen(corner_change[0], corner_change[1], 1);
    fails(&[("boresight.toml", &job), ("corners-classic5.csv", &corners)], &[], code, parts);
}

const SAME: [&str; 2] = ["", ""];

#[test]
fn mistakes_in_the_job_are_named() {
    let swapped = job().replace("columns = 9 ", "columns = 6 ").replace("rows = 6", "rows = 9");
    let parts = ["corners-classic5.csv:", "hint: ", "columns = 9, rows = 6"];
    fails(&[("boresight.toml", &swapped), ("corners-classic5.csv", &corners())], &[], 2, &parts);
    let parts = ["boresight.toml:", "25 m", "were millimetres meant? Then it is 0.025 m", "hint: "];
    fails_changed(["spacing_m = 0.025", "spacing_m = 25"], SAME, 2, &parts);
    let parts = ["boresight.toml:", "[options]", "unknown field `modle`", "hint: "];
    fails_changed(["model = ", "modle = "], SAME, 2, &parts);
    let parts = ["boresight.toml:", "no lens model `opencv6`", "opencv5", "hint: "];
    fails_changed(["\"opencv5\"", "\"opencv6\""], SAME, 2, &parts);
}

#[test]
fn mistakes_in_the_corners_are_named() {
    fails_changed(SAME, ["244.42749,", "nan,"], 3, &["corners-classic5.csv:2", "nan"]);
    let parts =
        ["corners-classic5.csv:2", "unknown camera `lfet`", "left, right", "hint: did you mean `left`?"];
    fails_changed(SAME, ["left,left01", "lfet,left01"], 3, &parts);
    fails(
        &[("boresight.toml", &job()), ("corners-classic5.csv", "")],
        &[],
        3,
        &["corners-classic5.csv: the file is empty"],
    );
    fails(&[("boresight.toml", &job())], &[], 3, &["corners-classic5.csv: cannot be read"]);
}

#[test]
fn one_view_is_too_few() {
    let corners = corners();
    let few: String = corners
        .lines()
        .filter(|line| line.starts_with("camera,") || line.contains("01.jpg"))
        .fold(String::new(), |text, line| text + line + "\n");
    let parts = [" has 1 usable views; 3 are needed", "hint: show the target"];
    fails(&[("boresight.toml", &job()), ("corners-classic5.csv", &few)], &[], 3, &parts);
}

#[test]
fn a_truncated_vnl_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut vnl = "# filename x y level\n".to_owned();
    for image in 0..4 {
        for point in 0..54 {
            vnl += &format!("left{image}.png {} {} 0\n", 50 + 10 * (point % 9), 60 + 10 * (point / 9));
        }
    }
    std::fs::write(folder.path().join("c.vnl"), &vnl[..vnl.len() - 100]).unwrap();
    let flags = ["calibrate", "c.vnl", "--target", "chessboard:9x6:25mm", "--image-size", "640x480"];
    fails_with(folder.path(), &flags, 3, &["c.vnl:", "hint: ", "cut off"]);
    assert!(!folder.path().join("out").exists());
}

#[test]
fn mistakes_on_the_command_line_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let stereo = dataset("opencv-stereo");
    for (flags, parts) in [
        (&["--model", "opencv6"][..], &["no lens model `opencv6`", "opencv5", "kannala-brandt4"][..]),
        (&["--model", "opencv5,middle=eucm"], &["no camera `middle`", "left, right"]),
        (&["--model", "cahvore"], &["cahvore cannot be calibrated", "hint: take --model cahvor"]),
        (&["--hold", "k99"], &["`k99` is not one of", "lens"]),
        (&["--hold", "k4"], &["camera left (opencv5) has no parameter k4", "hint: it has fx, fy"]),
        (&["--model", "opencv8,right=opencv5", "--hold", "k4:right"], &["camera right (opencv5) has no"]),
        (&["--hold", "fx"], &["fx of camera left cannot be held", "--prior"]),
        (&["--share-lens", "left+middle"], &["no camera `middle`", "left, right"]),
        (&["--shape", "3"], &["`3` is not one of: none, 2, 6, auto"]),
        (
            &["--shape", "6", "--regularization", "mrcal-2.2"],
            &["option shape: mrcal-2.2", "hint: take --shape 2"],
        ),
        (&["--reject", "-1"], &["-1"]),
        (&["--loss", "huber:1"], &["huber:1", "cauchy:PX"]),
        (&["--cameras", "left,middle"], &["no camera `middle`", "left, right"]),
        (&["--target", "chessboard:9x6:25"], &["no unit", "chessboard:9x6:25mm"]),
        (&["--image-size", "640"], &["640x480"]),
        (&["--image-size", "middle=640x480"], &["no camera `middle`", "left, right"]),
        (&["--frobnicate"], &["--frobnicate"]),
        (&["--clock", "log"], &["--clock says nothing of files of corners", "hint: leave it out"]),
        (&["--sync-tolerance", "5ms"], &["--sync-tolerance says nothing of files of corners"]),
        (&["--camera", "left=left*"], &["corners-classic5.csv", "says itself which camera", "--camera out"]),
    ] {
        let arguments: Vec<&str> = ["calibrate", &stereo].into_iter().chain(flags.iter().copied()).collect();
        fails_with(folder.path(), &arguments, 2, parts);
    }
    fails_with(folder.path(), &["calibrate"], 2, &["INPUT"]);
    fails_with(folder.path(), &["calibrate", "gone"], 3, &["gone"]);
    let corners = dataset("opencv-stereo/corners-classic5.csv");
    fails_with(folder.path(), &["calibrate", &corners], 2, &["target", "hint: add --target"]);
    let flags = ["calibrate", &corners, "--target", "chessboard:9x6:25mm"];
    fails_with(folder.path(), &flags, 2, &["camera left", "hint: add --image-size"]);
    assert!(!folder.path().join("out").exists());
}

#[test]
fn what_is_in_the_way_of_the_output_stays() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("out"), "mine").unwrap();
    fails_with(folder.path(), &["calibrate", &dataset("opencv-stereo")], 5, &["out", "cannot be written"]);
    assert_eq!(std::fs::read_to_string(folder.path().join("out")).unwrap(), "mine");
}
