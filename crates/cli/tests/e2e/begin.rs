//! The command to begin with: a job file from data.

use crate::{boresight, dataset};

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
