//! The robot commands and stereo, on their committed jobs.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::{boresight, boresight_with_input, dataset, json};

fn truth(name: &str) -> Value {
    json(&fs::read_to_string(dataset(&format!("{name}/truth.json"))).unwrap())
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

#[test]
fn flanges_of_touches_are_read_as_their_maker_writes_them() {
    let folder = tempfile::tempdir().unwrap();
    // A tip 150 mm before the flange touches points of a plane that the image shows at 0.25 mm a pixel. The
    // flange looks down (c is half a turn) and turns about z by a: KUKA's R = Rz(a) Ry(b) Rx(c).
    let mut rows = String::from("u_px,v_px,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n");
    let mut rpy = String::from("u_px,v_px,x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg\n");
    let mut inverse = String::from("u_px,v_px,x_mm,y_mm,z_mm,r11,r12,r13,r21,r22,r23,r31,r32,r33\n");
    for i in 0..9 {
        let (u, v) = (400.0 + 300.0 * f64::from(i % 3), 300.0 + 250.0 * f64::from(i / 3));
        let (a, b) = (20.0 * f64::from(i) - 80.0, 12.0 * f64::from(i % 4) - 15.0);
        let ((sin_a, cos_a), (sin_b, cos_b)) = (a.to_radians().sin_cos(), b.to_radians().sin_cos());
        // The third column of R for c = 180 degrees, times the tip's length.
        let tip = [-cos_a * sin_b, -sin_a * sin_b, -cos_b].map(|x| 150.0 * x);
        let touched = [0.25 * u, -0.25 * v, 10.0];
        let flange = [0, 1, 2].map(|k| touched[k] - tip[k]);
        rows.push_str(&format!("{u},{v},{},{},{},{a},{b},180\n", flange[0], flange[1], flange[2]));
        rpy.push_str(&format!("{u},{v},{},{},{},180,{b},{a}\n", flange[0], flange[1], flange[2]));
        let columns = [
            [cos_a * cos_b, sin_a * cos_b, -sin_b],
            [sin_a, -cos_a, 0.0],
            [-cos_a * sin_b, -sin_a * sin_b, -cos_b],
        ];
        let back = columns.map(|column| -(0..3).map(|k| column[k] * flange[k]).sum::<f64>());
        let numbers: Vec<String> = back.iter().chain(columns.iter().flatten()).map(f64::to_string).collect();
        inverse.push_str(&format!("{u},{v},{}\n", numbers.join(",")));
    }
    for (name, text) in [("touches.csv", &rows), ("rpy.csv", &rpy), ("inverse.csv", &inverse)] {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let fit_file = |name: &str, how: &[&str]| {
        let arguments = ["robot", "plane", name, "--tip-mm", "0,0,150", "--json"];
        boresight(folder.path(), &[&arguments[..], how].concat())
    };
    let fit = |how: &[&str]| fit_file("touches.csv", how);
    for (name, how) in
        [("touches.csv", "kuka-abc"), ("rpy.csv", "urdf-rpy"), ("inverse.csv", "matrix:mm:inverse")]
    {
        let plane = json(&fit_file(name, &["--touches-as", how]).good());
        let touches = plane["touches"].as_array().unwrap();
        let residuals = touches.iter().flat_map(|touch| numbers(&touch["residual_m"]));
        let worst = residuals.fold(0.0f64, |most, residual| most.max(residual.abs()));
        assert!(worst < 1e-9, "{name}: {worst}");
    }
    for name in ["touches.csv", "rpy.csv"] {
        let run = fit_file(name, &[]);
        assert!(run.code == Some(2) && run.stderr.contains("--touches-as"), "{}", run.stderr);
    }
    // A convention that is not of these columns is not passed over.
    let run = fit(&["--touches-as", "ros"]);
    assert!(run.code == Some(2) && run.stderr.contains("a, b, c, which cannot be read as"), "{}", run.stderr);
    let run = fit_file("inverse.csv", &["--touches-as", "kuka-abc"]);
    assert!(
        run.code == Some(2) && run.stderr.contains("which cannot be read as moving-zyx"),
        "{}",
        run.stderr
    );
    fs::write(folder.path().join("flat.csv"), "u_px,v_px,x_mm,y_mm\n1,2,3,4\n").unwrap();
    let run = fit_file("flat.csv", &["--touches-as", "kuka-abc"]);
    assert!(run.code == Some(2) && run.stderr.contains("no rotations"), "{}", run.stderr);
    // Read in another order, they meet no plane.
    let other = json(&fit(&["--touches-as", "moving-xyz"]).good());
    let off = other["touches"].as_array().unwrap().iter().map(|touch| numbers(&touch["residual_m"])[2].abs());
    assert!(off.fold(0.0, f64::max) > 1e-3);
}

#[test]
fn a_plane_is_found_and_parts_are_placed() {
    let folder = tempfile::tempdir().unwrap();
    let job = dataset("robot-plane");
    let text = boresight(folder.path(), &["robot", "plane", &job]).good();
    assert!(text.contains("9 touches; model ") && text.contains("written: out/plane.json"), "{text}");
    let plane = json(&fs::read_to_string(folder.path().join("out/plane.json")).unwrap());
    let left_out = |model: &str| {
        let tried = plane["tried"].as_array().unwrap().iter().find(|tried| tried["model"] == model).unwrap();
        tried["left_out_rms_m"].as_f64().unwrap()
    };
    assert!(left_out("affine") > 1e-3 && left_out("pose") < 3e-4, "{text}");
    let place = numbers(&truth("robot-plane")["base_from_cam"]["translation_mm"]);
    for (found, expected) in numbers(&plane["plane"]["camera_in_base_m"]).iter().zip(&place) {
        // Half a metre away, a tenth of a millimetre at 150 mm is a few tenths.
        assert!((1e3 * found - expected).abs() < 2.0, "{found} {expected}");
    }

    let placed = boresight(folder.path(), &["robot", "pose", &job, "--plane", "out", "--json"]).good();
    let placed = json(&placed);
    for (found, expected) in
        placed["objects"].as_array().unwrap().iter().zip(truth("robot-plane")["objects"].as_array().unwrap())
    {
        let position = numbers(&expected["position_mm"]);
        let covariance = found["covariance_x_y_z_m_turn_rad"].as_array().unwrap();
        for (i, axis) in ["x_m", "y_m", "z_m"].iter().enumerate() {
            let error_mm = 1e3 * found[axis].as_f64().unwrap() - position[i];
            let sigma_mm = 1e3 * numbers(&covariance[i])[i].sqrt();
            assert!(error_mm.abs() < 4.0 * sigma_mm && sigma_mm < 0.3, "{axis}: {error_mm} ± {sigma_mm}");
        }
        let off = found["turn_rad"].as_f64().unwrap().to_degrees() - expected["turn_deg"].as_f64().unwrap();
        let off = (off + 180.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() < 0.5, "{off}");
    }
    let text = boresight(folder.path(), &["robot", "pose", &job, "--plane", "out"]).good();
    assert!(text.contains("in the robot's base frame"), "{text}");
    // A pixel pair of numbers alone, without a height: the warning says what a millimetre does.
    fs::write(folder.path().join("one.csv"), "u_px,v_px,phi_deg\n1100,950,0\n").unwrap();
    let run = boresight(folder.path(), &["robot", "pose", "one.csv", "--plane", "out"]);
    assert!(run.code == Some(0) && run.stderr.contains("caution[height-unknown]"), "{}", run.stderr);
}

#[test]
fn a_vendors_table_of_nine_points_is_enough() {
    let folder = tempfile::tempdir().unwrap();
    let touches = fs::read_to_string(dataset("robot-plane/touches.csv")).unwrap();
    let table: Vec<String> = touches
        .lines()
        .map(|line| line.split(',').take(5).collect::<Vec<_>>().join(";").replace('.', ","))
        .collect();
    fs::write(folder.path().join("nine.csv"), table.join("\n")).unwrap();
    let run = boresight(folder.path(), &["robot", "plane", "nine.csv", "--sigma-touch-mm", "0.1"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    // Without the lens the distortion stays in, and is told.
    assert!(run.stderr.contains("caution[touches-worse-than-stated]"), "{}", run.stderr);
    assert!(run.stderr.contains("note[no-heights]"), "{}", run.stderr);
    let affine = boresight(folder.path(), &["robot", "plane", "nine.csv", "--model", "affine"]).good();
    assert!(affine.contains("model affine: as asked for"), "{affine}");
}

/// Runs a plane on some rows of the touches, which must fail without a file.
fn refused(rows: &[usize], code: i32, message: &str) {
    let folder = tempfile::tempdir().unwrap();
    let touches = fs::read_to_string(dataset("robot-plane/touches.csv")).unwrap();
    let lines: Vec<&str> = touches.lines().collect();
    let chosen: Vec<&str> = [0].iter().chain(rows).map(|&row| lines[row]).collect();
    fs::write(folder.path().join("t.csv"), chosen.join("\n")).unwrap();
    let run = boresight(folder.path(), &["robot", "plane", "t.csv"]);
    assert_eq!(run.code, Some(code), "{rows:?}: {}", run.stderr);
    assert!(run.stderr.contains(message) && run.stdout.is_empty(), "{rows:?}: {}", run.stderr);
    assert!(!Path::new(&folder.path().join("out")).exists());
}

#[test]
fn degenerate_touches_exit_with_four_and_write_nothing() {
    refused(&[1, 2, 3], 4, "the touches lie on a line");
    refused(&[1, 9], 4, "2 touches at distinct points are given; 3 are needed");
    refused(&[1, 5, 5, 5], 4, "2 touches at distinct points are given");
    refused(&[], 4, "0 touches at distinct points");
}

#[test]
fn bad_tables_and_options_name_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("t.csv"), "u,v,x,y\n1,2,3,4\n").unwrap();
    let run = boresight(folder.path(), &["robot", "plane", "t.csv"]);
    assert!(run.code == Some(3) && run.stderr.contains("has no column u_px"), "{}", run.stderr);
    fs::write(folder.path().join("t.csv"), "u_px,v_px,x_mm,y_mm\n1,2,3,x\n").unwrap();
    let run = boresight(folder.path(), &["robot", "plane", "t.csv"]);
    assert!(run.code == Some(3) && run.stderr.contains("t.csv:2: y_mm is `x`"), "{}", run.stderr);
    let run = boresight(folder.path(), &["robot", "plane", &dataset("robot-plane"), "--model", "cubic"]);
    assert!(run.code == Some(2) && run.stderr.contains("the models are auto, similarity"), "{}", run.stderr);
    let run = boresight(folder.path(), &["robot", "pose", &dataset("robot-plane")]);
    assert!(run.code == Some(2) && run.stderr.contains("no plane is given"), "{}", run.stderr);
    let run = boresight(folder.path(), &["robot", "plane", &dataset("rig4-synthetic")]);
    assert!(run.code == Some(2) && run.stderr.contains("no table [plane]"), "{}", run.stderr);
}

/// The distance in mm of a pose of the answer from the truth.
fn off_mm(pose: &Value) -> f64 {
    let place = numbers(&truth("robot-locate")["cam_from_object"]["translation_mm"]);
    let found = numbers(&pose["cam_from_object"]["translation_m"]);
    found.iter().zip(&place).map(|(found, place)| (1e3 * found - place).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn an_object_is_located_by_five_points_and_by_three() {
    let folder = tempfile::tempdir().unwrap();
    let job = dataset("robot-locate");
    let five = json(&boresight(folder.path(), &["robot", "locate", &job, "--json"]).good());
    assert_eq!(five["poses"].as_array().unwrap().len(), 1);
    assert!(off_mm(&five["poses"][0]) < 1.0, "{five}");
    let camera = dataset("robot-locate/camera.yml");
    let triangle = dataset("robot-locate/triangle.csv");
    let flags = ["robot", "locate", &triangle, "--calibration", &camera];
    let run = boresight(folder.path(), &[&flags[..], &["--json"]].concat());
    assert!(run.stderr.contains("caution[ambiguous-pose]"), "{}", run.stderr);
    let three = json(&run.good());
    let poses = three["poses"].as_array().unwrap();
    assert!(poses.len() >= 2 && poses.iter().any(|pose| off_mm(pose) < 2.0), "{three}");
    // Only the sides are known: 60, 70.71 and 50.99 mm, and three pixels.
    let lines = fs::read_to_string(&triangle).unwrap();
    let table: Vec<String> = lines.lines().take(4).map(str::to_owned).collect();
    fs::write(folder.path().join("abc.csv"), table.join("\n")).unwrap();
    let sides = [
        "robot",
        "locate",
        "abc.csv",
        "--calibration",
        &camera,
        "--sides-mm",
        "60,70.7107,50.9902",
        "--json",
    ];
    let by_sides = json(&boresight(folder.path(), &sides).good());
    assert_eq!(by_sides["poses"].as_array().unwrap().len(), poses.len());
    let run = boresight(folder.path(), &[&sides[..6], &["10,20,50"]].concat());
    assert!(run.code == Some(4) && run.stderr.contains("no triangle has these sides"), "{}", run.stderr);
    let text = boresight(folder.path(), &["robot", "locate", &job]).good();
    assert!(text.contains("sigmas by pixels alone"), "{text}");
}

#[test]
fn stereo_finds_points_with_sigmas() {
    let folder = tempfile::tempdir().unwrap();
    boresight(folder.path(), &["calibrate", &dataset("opencv-stereo")]).good();
    let points = "0.05 -0.03 0.6\n-0.1 0.02 0.8\n";
    let pixels = ["left", "right"].map(|camera| {
        let flags = ["project", "out", "--camera", camera, "--frame", "rig"];
        boresight_with_input(folder.path(), &flags, points).good()
    });
    let pairs: Vec<String> =
        pixels[0].lines().zip(pixels[1].lines()).map(|(l, r)| format!("{l} {r}")).collect();
    for method in ["optimal", "rectified"] {
        let flags = ["stereo", "out", "--method", method];
        let found = boresight_with_input(folder.path(), &flags, &pairs.join("\n")).good();
        for (line, point) in found.lines().skip(1).zip(points.lines()) {
            let found: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
            for (found, expected) in found.iter().zip(point.split(' ')) {
                assert!((found - expected.parse::<f64>().unwrap()).abs() < 1e-8, "{method}: {line}");
            }
            if method == "optimal" {
                assert!(found[5] > 5e-4 && found[5] < 1e-2 && found[6] < 1e-6, "{line}");
            }
        }
    }
    // One camera moved by 0.1 m to the right.
    let first =
        boresight_with_input(folder.path(), &["project", "out", "--camera", "left"], "0 0 1\n").good();
    let second =
        boresight_with_input(folder.path(), &["project", "out", "--camera", "left"], "-0.1 0 1\n").good();
    let flags = ["stereo", "out", "--cameras", "left", "--moved", "0,0,0,-0.1,0,0"];
    let found =
        boresight_with_input(folder.path(), &flags, &format!("{} {}", first.trim(), second.trim())).good();
    let depth: f64 = found.lines().nth(1).unwrap().split(' ').nth(2).unwrap().parse().unwrap();
    assert!((depth - 1.0).abs() < 1e-8, "{found}");
    for (cameras, moved, part) in [
        ("left,right", "0,0,0,-0.1,0,0", "--moved is of one camera"),
        ("left", "0,0.1,0,0,0,0", "leaves the camera where it was"),
    ] {
        let flags = ["stereo", "out", "--cameras", cameras, "--moved", moved];
        let refused = boresight_with_input(folder.path(), &flags, "300 200 260 212\n");
        assert_eq!(refused.code, Some(2), "{}", refused.stderr);
        assert!(refused.stderr.contains(part), "{}", refused.stderr);
    }
    for cameras in ["left", "left,left"] {
        let flags = ["stereo", "out", "--cameras", cameras];
        let alone = boresight_with_input(folder.path(), &flags, "300 200\n");
        assert!(alone.code == Some(2) && alone.stderr.contains("left is one"), "{}", alone.stderr);
    }
    let bad = boresight_with_input(folder.path(), &["stereo", "out"], "1 2 3\n");
    assert!(bad.code == Some(3) && bad.stderr.contains("4 are needed"), "{}", bad.stderr);
    let swapped = pairs[0].split(' ').collect::<Vec<_>>();
    let swapped = [swapped[2], swapped[3], swapped[0], swapped[1]].join(" ");
    let behind = boresight_with_input(folder.path(), &["stereo", "out"], &swapped);
    assert!(behind.code == Some(4) && behind.stderr.contains("no line has a point"), "{}", behind.stderr);
}

/// Writes the committed touches with each row changed, fits a plane to them and returns the run.
fn plane_of_changed(
    folder: &Path,
    header: &str,
    row: impl Fn(&str, [f64; 5]) -> String,
    more: &[&str],
) -> crate::Run {
    let touches = fs::read_to_string(dataset("robot-plane/touches.csv")).unwrap();
    let mut text = format!("{header}\n");
    for line in touches.lines().skip(1) {
        let (name, numbers) = line.split_once(',').unwrap();
        let numbers: Vec<f64> = numbers.split(',').map(|number| number.parse().unwrap()).collect();
        text.push_str(&format!("{}\n", row(name, numbers.try_into().unwrap())));
    }
    fs::write(folder.join("changed.csv"), text).unwrap();
    let camera = dataset("robot-plane/camera.yml");
    let arguments = ["robot", "plane", "changed.csv", "--calibration", &camera];
    boresight(folder, &[&arguments[..], more].concat())
}

#[test]
fn touches_that_no_robot_makes_are_told() {
    const HEADER: &str = "name,u_px,v_px,x_mm,y_mm,z_mm";
    let folder = tempfile::tempdir().unwrap();
    let metres = |name: &str, [u, v, x, y, z]: [f64; 5]| {
        format!("{name},{u},{v},{},{},{}", 1e-3 * x, 1e-3 * y, 1e-3 * z)
    };
    let run = plane_of_changed(folder.path(), HEADER, metres, &[]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stderr.contains("fail[touch-unit]") && run.stderr.contains("x_m,y_m,z_m"), "{}", run.stderr);
    let run = plane_of_changed(folder.path(), HEADER, metres, &["--sigma-touch-mm", "0.1"]);
    assert!(run.stderr.contains("caution[touches-better-than-stated]"), "{}", run.stderr);
    let same = |name: &str, [u, v, x, y, z]: [f64; 5]| format!("{name},{u},{v},{x},{y},{z}");
    let run = plane_of_changed(folder.path(), "name,u_px,v_px,x_m,y_m,z_m", same, &[]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stderr.contains("fail[touch-unit]") && run.stderr.contains("x_mm,y_mm"), "{}", run.stderr);
    // Pixels and positions exchanged, then u and v.
    let exchanged = |name: &str, [u, v, x, y, z]: [f64; 5]| format!("{name},{x},{y},{u},{v},{z}");
    let run = plane_of_changed(folder.path(), HEADER, exchanged, &[]);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stderr.contains("fail[touch-outside-image]"), "{}", run.stderr);
    assert!(run.stderr.contains("caution[touches-coarse]"), "{}", run.stderr);
    let mirrored = |name: &str, [u, v, x, y, z]: [f64; 5]| format!("{name},{v},{u},{x},{y},{z}");
    let run = plane_of_changed(folder.path(), HEADER, mirrored, &[]);
    assert!(run.stderr.contains("fail[touch-outside-image]"), "{}", run.stderr);
    assert!(run.stderr.contains("note[camera-below-plane]"), "{}", run.stderr);
    // As they are, nothing of this is said.
    let run = plane_of_changed(folder.path(), HEADER, same, &[]);
    assert!(run.code == Some(0) && !run.stderr.contains("touch-") && !run.stderr.contains("touches-"));
}

#[test]
fn parts_that_cannot_be_there_are_told() {
    let folder = tempfile::tempdir().unwrap();
    boresight(folder.path(), &["robot", "plane", &dataset("robot-plane")]).good();
    fs::write(folder.path().join("one.csv"), "u_px,v_px,phi_deg\n1100,950,0\n").unwrap();
    fs::write(folder.path().join("far.csv"), "u_px,v_px,phi_deg\n5000,950,0\n").unwrap();
    let placed = |table: &str, height: &str| {
        boresight(folder.path(), &["robot", "pose", table, "--plane", "out", "--height-mm", height])
    };
    for (height, part) in [("600", "the camera is "), ("nan", "height_m is NaN")] {
        let run = placed("one.csv", height);
        assert_eq!(run.code, Some(2), "{height}: {}", run.stderr);
        assert!(run.stdout.is_empty() && run.stderr.contains(part), "{height}: {}", run.stderr);
    }
    let run = placed("far.csv", "0");
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stderr.contains("fail[object-outside-image]"), "{}", run.stderr);
    assert!(run.stderr.contains("caution[object-beside-touches]"), "{}", run.stderr);
    assert_eq!(placed("one.csv", "-3").code, Some(0));
}

#[test]
fn a_robot_on_wheels_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    // Wheels of 20 mm, 90 mm apart, the sensor in the middle.
    let rows = (0..60).map(|i| {
        let (left, right) = (f64::from(i).sin(), (1.7 * f64::from(i)).cos());
        let (turn, way) = (0.02 * (right - left) / 0.09, 0.01 * (left + right));
        let chord = way * (0.5 * turn).sin() / (0.5 * turn);
        let (x, y) = (chord * (0.5 * turn).cos(), chord * (0.5 * turn).sin());
        format!("{{\"T\": 1.0, \"phi_l\": {left}, \"phi_r\": {right}, \"sm\": [{x}, {y}, {turn}]}}")
    });
    // Two recordings that were joined share a line.
    let text = rows.collect::<Vec<String>>().join("\n").replacen("}\n{", "}{", 1);
    fs::write(folder.path().join("m.tuple"), text).unwrap();
    let found = json(&boresight(folder.path(), &["robot", "planar", "m.tuple", "--json"]).good());
    assert_eq!((found["schema"].as_str(), found["used"].as_u64()), (Some("boresight.planar/1"), Some(60)));
    assert!((found["parameters"][2]["value"].as_f64().unwrap() - 0.09).abs() < 1e-9, "{found}");
    let text = boresight(folder.path(), &["robot", "planar", "m.tuple"]).good();
    assert!(text.contains("axle_m"), "{text}");
    fs::write(folder.path().join("few.tuple"), "{\"T\": 1, \"phi_l\": 1, \"phi_r\": 1, \"sm\": [0,0,0]}")
        .unwrap();
    let run = boresight(folder.path(), &["robot", "planar", "few.tuple"]);
    assert!(run.code == Some(4) && run.stderr.contains("10 are needed"), "{}", run.stderr);
}
