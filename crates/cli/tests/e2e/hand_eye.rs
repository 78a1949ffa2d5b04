//! `boresight robot hand-eye` and `boresight robot poses` on the committed synthetic robots.

use std::fmt::Write as _;
use std::path::PathBuf;

use crate::{boresight, dataset};

/// Returns the pose table of a dataset with numbers changed, by their columns' names; those for which `change` has nothing stay.
fn changed_poses(name: &str, change: impl Fn(&str, f64) -> Option<f64>) -> String {
    let table = std::fs::read_to_string(dataset(&format!("{name}/poses.csv"))).unwrap();
    let (header, rows) = table.split_once('\n').unwrap();
    let columns: Vec<&str> = header.split(',').collect();
    let changed = |line: &str| {
        let fields = line.split(',').zip(&columns).map(|(field, column)| {
            let number = field.parse().ok().and_then(|number| change(column, number));
            number.map_or_else(|| field.to_owned(), |number| number.to_string())
        });
        fields.collect::<Vec<String>>().join(",") + "\n"
    };
    format!("{header}\n{}", rows.lines().map(changed).collect::<String>())
}

#[test]
fn the_synthetic_robots_are_calibrated_to_their_truth() {
    for (name, pose) in
        [("robot-hand-eye-on-flange", "flange_from_rig"), ("robot-hand-eye-fixed", "base_from_rig")]
    {
        let folder = tempfile::tempdir().unwrap();
        let run = boresight(folder.path(), &["robot", "hand-eye", &dataset(name), "--json"]);
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        let found: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(found["schema"], "boresight.hand-eye/1");
        let truth = std::fs::read_to_string(dataset(&format!("{name}/truth.json"))).unwrap();
        let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
        let own = found["poses"].as_array().unwrap().iter().find(|one| one["name"] == pose).unwrap();
        for axis in 0..3 {
            let error_m = own["translation_m"][axis].as_f64().unwrap()
                - truth["carrier_from_rig"]["translation_m"][axis].as_f64().unwrap();
            let sigma_m = own["sigma_rad_m"][3 + axis].as_f64().unwrap_or(3e-4);
            assert!(error_m.abs() < 4.0 * sigma_m && sigma_m < 1e-3, "{name}: {error_m} {sigma_m}");
        }
        let noise = &found["robot_noise"];
        for (which, sigma) in [("rotation_rad", 4e-4), ("translation_m", 3e-4)] {
            let ratio = noise[which].as_f64().unwrap() / sigma;
            assert!((ratio - 1.0).abs() < 0.3, "{name}: {which} {ratio}");
        }
        // These robots are not stretched: their positions hold as they are said, and the noise has its own sigma.
        assert!(
            found["stretch"].is_null() && found["without_stretch"].is_null(),
            "{name}: {}",
            found["stretch"]
        );
        for which in ["relative_sigma_rotation", "relative_sigma_translation"] {
            assert!((0.02..0.3).contains(&noise[which].as_f64().unwrap()), "{name}: {noise}");
        }
        assert!(folder.path().join("out/hand-eye.json").is_file());
        assert!(folder.path().join("out/calibration.json").is_file());
    }
}

/// Writes 24 poses `x y z rx ry rz`, metres and a rotation vector.
fn poses(pose: impl Fn(f64) -> [f64; 6]) -> String {
    let mut text = String::new();
    for i in 0..24 {
        let numbers = pose(f64::from(i)).map(|number| number.to_string());
        let _ = writeln!(text, "{}", numbers.join(" "));
    }
    text
}

#[test]
fn degenerate_motions_are_refused_and_nothing_is_written() {
    let wave = |i: f64| [0.5 + 0.1 * i.sin(), 0.2 * i.cos(), 0.4 + 0.01 * i];
    let cases: [(&str, String, &str); 4] = [
        (
            "pure translation",
            poses(|i| [wave(i)[0], wave(i)[1], wave(i)[2], 0.1, 0.2, 0.3]),
            "robot-no-rotation",
        ),
        ("one axis", poses(|i| [wave(i)[0], wave(i)[1], wave(i)[2], 0.0, 0.0, 0.1 * i]), "robot-one-axis"),
        ("two poses", poses(|i| [0.5, 0.0, 0.4, 0.0, 0.6 * (i % 2.0), 0.0]), "robot-few-poses"),
        ("identical poses", poses(|_| [0.5, 0.0, 0.4, 0.1, 0.2, 0.3]), "robot-few-poses"),
    ];
    for (name, text, code) in cases {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("poses.txt"), text).unwrap();
        let arguments = ["robot", "hand-eye", &dataset("robot-hand-eye-on-flange"), "--poses", "poses.txt"];
        let run = boresight(folder.path(), &[&arguments[..], &["--poses-as", "universal-robots"]].concat());
        assert_eq!(run.code, Some(4), "{name}: {}", run.stderr);
        assert!(run.stderr.contains(code) && run.stderr.contains("hint: Add"), "{name}: {}", run.stderr);
        assert!(run.stdout.is_empty() && !folder.path().join("out").exists(), "{name}");
    }
}

#[test]
fn poses_that_are_misread_are_told_wherever_they_fail() {
    let folder = tempfile::tempdir().unwrap();
    let fixed = dataset("robot-hand-eye-fixed");
    // Radians under a header of degrees: the robot hardly turns.
    let in_radians = |column: &str, number: f64| column.ends_with("_deg").then(|| number.to_radians());
    let text = changed_poses("robot-hand-eye-fixed", in_radians);
    std::fs::write(folder.path().join("poses.csv"), text).unwrap();
    let run = boresight(folder.path(), &["robot", "hand-eye", &fixed, "--poses", "poses.csv"]);
    assert_eq!(run.code, Some(4), "{}", run.stderr);
    for part in ["robot-no-rotation", "misread", "moving-zyx:rad:mm"] {
        assert!(run.stderr.contains(part), "`{part}` is not in: {}", run.stderr);
    }
    // The wrong mount, which an adjustment may begin from and not end.
    let run = boresight(folder.path(), &["robot", "hand-eye", &fixed, "--mount", "on-flange"]);
    assert!(matches!(run.code, Some(1 | 4)), "{}", run.stderr);
    assert!(run.stderr.contains("cameras fixed") && !run.stderr.contains("simpler lens"), "{}", run.stderr);
}

#[test]
fn a_stretched_robot_is_told_with_how_to_correct_it() {
    let folder = tempfile::tempdir().unwrap();
    let name = "robot-hand-eye-on-flange";
    // The robot says positions that are too short by 2 % along x.
    let text = changed_poses(name, |column, number| (column == "x_m").then_some(0.98 * number));
    std::fs::write(folder.path().join("poses.csv"), text).unwrap();
    let arguments = ["robot", "hand-eye", &dataset(name), "--poses", "poses.csv"];
    let run = boresight(folder.path(), &arguments);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(
        run.text().contains("stretch: these poses hold for the flange at position + S"),
        "{}",
        run.text()
    );
    assert!(run.text().contains("positions as the robot says them"), "{}", run.text());
    assert!(run.stderr.contains("[robot-stretched]"), "{}", run.stderr);
    let found = std::fs::read_to_string(folder.path().join("out/hand-eye.json")).unwrap();
    let found: serde_json::Value = serde_json::from_str(&found).unwrap();
    let along_x = found["stretch"]["matrix"][0][0].as_f64().unwrap();
    assert!((along_x - (1.0 / 0.98 - 1.0)).abs() < 4e-3, "{along_x}");
    let mean_of =
        |figures: &serde_json::Value| figures["leave_one_out"]["figures"]["mean_m"].as_f64().unwrap();
    assert!(mean_of(&found) < 0.6 * mean_of(&found["without_stretch"]), "{found}");
    assert_eq!(found["without_stretch"]["poses"].as_array().unwrap().len(), 2);
}

#[test]
fn poses_of_other_frames_are_no_good_result() {
    let folder = tempfile::tempdir().unwrap();
    let fixed = dataset("robot-hand-eye-fixed");
    let table = std::fs::read_to_string(dataset("robot-hand-eye-fixed/poses.csv")).unwrap();
    // Two rows in each other's place.
    let exchanged =
        table.replace("frame003", "third").replace("frame004", "frame003").replace("third", "frame004");
    assert_ne!(exchanged, table);
    std::fs::write(folder.path().join("poses.csv"), exchanged).unwrap();
    for command in ["hand-eye", "poses"] {
        let run = boresight(folder.path(), &["robot", command, &fixed, "--poses", "poses.csv"]);
        assert_eq!(run.code, Some(1), "{command}: {}", run.stderr);
        assert!(run.stderr.contains("fail[robot-misfit]"), "{command}: {}", run.stderr);
    }
}

#[test]
fn a_left_handed_robot_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let name = "robot-hand-eye-on-flange";
    // The mirror image of all poses in the plane of x and z.
    let mirrored = |column: &str, number: f64| ["y_m", "qx", "qz"].contains(&column).then_some(-number);
    std::fs::write(folder.path().join("poses.csv"), changed_poses(name, mirrored)).unwrap();
    let run = boresight(folder.path(), &["robot", "hand-eye", &dataset(name), "--poses", "poses.csv"]);
    assert_eq!(run.code, Some(4), "{}", run.stderr);
    assert!(run.stderr.contains("only if the camera is mirrored"), "{}", run.stderr);
    assert!(run.stdout.is_empty() && !folder.path().join("out").exists(), "{}", run.stderr);
}

#[test]
fn frames_without_a_pose_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let name = "robot-hand-eye-fixed";
    let table = std::fs::read_to_string(dataset(&format!("{name}/poses.csv"))).unwrap();
    std::fs::write(folder.path().join("poses.csv"), table.replace("frame003", "frame3")).unwrap();
    let run = boresight(folder.path(), &["robot", "hand-eye", &dataset(name), "--poses", "poses.csv"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    for part in ["note[robot-unpaired]", "1 of 24 frames", "such as frame003", "such as frame3)"] {
        assert!(run.stderr.contains(part), "`{part}` is not in: {}", run.stderr);
    }
}

#[test]
fn a_height_and_a_tip_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let source = PathBuf::from(dataset("robot-hand-eye-fixed"));
    for name in ["corners.csv", "poses.csv"] {
        std::fs::copy(source.join(name), folder.path().join(name)).unwrap();
    }
    let job = std::fs::read_to_string(source.join("boresight.toml")).unwrap();
    for (line, part) in [
        ("axes = 4\nheight_m = 30.0", "height_m is 30"),
        ("axes = 4\nheight_m = nan", "height_m is NaN"),
        ("tip_mm = [0.0, nan, 150.0]", "tip_mm is [0.0, NaN, 150.0]"),
    ] {
        std::fs::write(folder.path().join("boresight.toml"), format!("{job}\n{line}\n")).unwrap();
        let run = boresight(folder.path(), &["robot", "hand-eye", "."]);
        assert_eq!(run.code, Some(2), "{line}: {}", run.stderr);
        assert!(run.stderr.contains(part) && run.stderr.contains("hint: write"), "{line}: {}", run.stderr);
    }
}

/// A row `time x y z qx qy qz qw` of a flange that waves about x and y.
fn timed_flange(time_s: f64) -> String {
    let (a, b) = (0.3 * (1.3 * time_s).sin(), 0.25 * (0.9 * time_s + 0.02 * time_s * time_s).cos());
    // The product of a turn about x by 2a and one about y by 2b.
    let (qx, qy, qz, qw) = (a.sin() * b.cos(), a.cos() * b.sin(), a.sin() * b.sin(), a.cos() * b.cos());
    format!("{time_s} {} {} 0.5 {qx} {qy} {qz} {qw}\n", 0.1 * b, 0.2 * a)
}

#[test]
fn a_job_of_poses_needs_no_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    let arm: String = (0..3000).map(|i| timed_flange(0.01 * f64::from(i))).collect();
    // A camera in the flange's own frame that looks at the base's: what it sees is the flange, inverted.
    let seen = (0..800).map(|i| 2.0 + f64::from(i) / 30.0).map(|time_s| {
        let row = timed_flange(time_s);
        let (_, pose) = row.split_once(' ').unwrap();
        format!("{} {pose}", time_s + 0.125)
    });
    write("arm.txt", &arm);
    write("seen.txt", &seen.collect::<String>());
    write(
        "boresight.toml",
        "[robot]\nposes = [\"arm.txt\"]\n[sights]\nposes = [\"seen.txt\"]\nconvention = \"ros:inverse\"\n",
    );
    let run = boresight(folder.path(), &["robot", "hand-eye", ".", "--mount", "on-flange", "--json"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    let found: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(found["schema"], "boresight.hand-eye-poses/1");
    let offset_s = found["clock"]["offset_s"].as_f64().unwrap();
    assert!((offset_s + 0.125).abs() < 1e-3, "{offset_s}");
    for axis in 0..3 {
        let at = found["poses"][0]["translation_m"][axis].as_f64().unwrap();
        assert!(at.abs() < 1e-3, "{at}");
    }
    assert!(run.stderr.contains("clock-offset"), "{}", run.stderr);
    assert!(folder.path().join("out/hand-eye.json").is_file());
    for flags in [&["--robot-noise", "none"][..], &["--target", "chessboard:9x6:25mm"]] {
        let run = boresight(folder.path(), &[&["robot", "hand-eye", "."], flags].concat());
        assert_eq!(run.code, Some(2), "{}", run.stderr);
        assert!(run.stderr.contains(&format!("{} says nothing of", flags[0])), "{}", run.stderr);
    }
    // Rows of both without times must be as many.
    write("arm.txt", "0 0 0.5 0 0 0 1\n");
    let run = boresight(folder.path(), &["robot", "hand-eye", "."]);
    assert_eq!(run.code, Some(3), "{}", run.stderr);
    assert!(run.stdout.is_empty() && run.stderr.contains("not all have a time"), "{}", run.stderr);
}

#[test]
fn the_doctor_names_the_convention() {
    let folder = tempfile::tempdir().unwrap();
    let fixed = dataset("robot-hand-eye-fixed");
    let good = boresight(folder.path(), &["robot", "poses", &fixed]);
    assert_eq!(good.code, Some(0), "{}", good.stderr);
    assert!(good.text().lines().nth(1).unwrap().contains("(stated)"), "{}", good.text());
    let bad = boresight(folder.path(), &["robot", "poses", &fixed, "--poses-as", "fanuc-wpr"]);
    assert_eq!(bad.code, Some(1), "{}", bad.stderr);
    assert!(bad.stderr.contains("kuka-abc") && bad.stderr.contains("times better"), "{}", bad.stderr);
    // A header that says metres of millimetres counts before what is stated, and is named.
    let table = std::fs::read_to_string(dataset("robot-hand-eye-fixed/poses.csv")).unwrap();
    std::fs::write(folder.path().join("poses.csv"), table.replace("_mm", "_m")).unwrap();
    let bad = boresight(folder.path(), &["robot", "poses", &fixed, "--poses", "poses.csv"]);
    assert_eq!(bad.code, Some(1), "{}", bad.stderr);
    assert!(bad.stderr.contains("kuka-abc") && bad.stderr.contains("x_m for x_mm"), "{}", bad.stderr);
    let none = boresight(folder.path(), &["robot", "hand-eye", &dataset("opencv-stereo")]);
    assert_eq!(none.code, Some(2), "{}", none.stderr);
    assert!(none.stderr.contains("no table of robot poses"), "{}", none.stderr);
}
