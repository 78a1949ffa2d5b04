use super::*;

fn camera() -> Camera {
    let params = vec![1200.0, 1190.0, 800.5, 610.0, -0.2, 0.05, 1e-3, -5e-4, 0.02];
    Camera::new("opencv5".parse().unwrap(), params, [1600, 1200]).unwrap()
}

fn truth() -> Pose {
    Pose::from_rodrigues(Vector3::new(0.4, -0.3, 0.8), Vector3::new(0.03, -0.02, 0.5))
}

fn points(corners: &[[f64; 3]]) -> Vec<LocatePoint> {
    let camera = camera();
    let one = |(i, &point_m): (usize, &[f64; 3])| LocatePoint {
        name: i.to_string(),
        point_m,
        pixel: camera.project(&(truth() * Vector3::from(point_m))),
    };
    corners.iter().enumerate().map(one).collect()
}

fn error(pose: &Pose) -> f64 {
    (*pose * truth().inverse()).log().norm()
}

const TRIANGLE: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [0.06, 0.0, 0.0], [0.01, 0.05, 0.0]];

#[test]
fn three_points_give_all_poses_and_say_so() {
    let mut given = points(&TRIANGLE);
    // A further point without a pixel is predicted.
    given.push(LocatePoint { name: "tip".to_owned(), point_m: [0.02, 0.02, 0.04], pixel: None });
    let found = locate(&camera(), None, &given, 0.1).unwrap();
    assert!(found.candidates.len() >= 2, "{found:?}");
    let nearest = found.candidates.iter().map(|candidate| error(&candidate.pose.cam_from_object));
    assert!(nearest.fold(f64::INFINITY, f64::min) < 1e-7);
    for candidate in &found.candidates {
        assert!(candidate.pose.rms_px() < 1e-6, "{candidate:?}");
        assert!(candidate.predicted_px[3].is_some() && candidate.condition.is_some());
        assert_eq!(candidate.is_used, [true, true, true, false]);
    }
    assert!(found.findings.iter().any(|finding| finding.code == "ambiguous-pose"));
}

#[test]
fn a_fourth_point_decides() {
    let found =
        locate(&camera(), None, &points(&[&TRIANGLE[..], &[[0.03, 0.02, 0.05]]].concat()), 0.1).unwrap();
    assert_eq!(found.candidates.len(), 1, "{found:?}");
    assert!(error(&found.candidates[0].pose.cam_from_object) < 1e-7);
    assert_eq!(found.findings, []);
}

#[test]
fn a_point_that_is_paired_wrongly_is_left_out_and_told() {
    let mut corners = Vec::new();
    for i in 0..12 {
        let f = f64::from(i);
        corners.push([0.02 * (f % 4.0), 0.02 * (f / 4.0).floor(), 0.01 * (f * 1.7).sin()]);
    }
    let mut given = points(&corners);
    let pixel = given[5].pixel.as_mut().unwrap();
    pixel[0] += 25.0;
    let found = locate(&camera(), None, &given, 0.1).unwrap();
    assert!(error(&found.candidates[0].pose.cam_from_object) < 1e-7, "{found:?}");
    assert!(!found.candidates[0].is_used[5]);
    let told = found.findings.iter().find(|finding| finding.code == "outlying-point").unwrap();
    assert!(told.place == "point 5" && (told.measured.unwrap() - 25.0).abs() < 0.1, "{told:?}");
}

#[test]
fn what_leaves_no_pose_is_refused() {
    let line = [[0.0; 3], [0.02, 0.0, 0.0], [0.05, 0.0, 0.0]];
    let collinear = locate(&camera(), None, &points(&line), 0.1).unwrap_err();
    assert!(matches!(collinear, RobotError::ThreePoint(_)), "{collinear}");
    let four = [&line[..], &[[0.06, 0.0, 0.0]]].concat();
    assert!(locate(&camera(), None, &points(&four), 0.1).is_err());
    let two = locate(&camera(), None, &points(&TRIANGLE[..2]), 0.1).unwrap_err();
    assert_eq!(two, RobotError::TooFew { what: "seen points", found: 2, need: 3 });
    let bad = locate(&camera(), None, &points(&TRIANGLE), -1.0).unwrap_err();
    assert!(matches!(bad, RobotError::BadOption { .. }));
}
