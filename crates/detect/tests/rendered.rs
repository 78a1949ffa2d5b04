//! Detection on rendered boards, where the truth is known.

#![allow(clippy::unwrap_used, reason = "a test may stop at what it does not expect")]

#[path = "rendered/dots.rs"]
mod dots;
#[path = "rendered/prints.rs"]
mod prints;
#[path = "rendered/sizes.rs"]
mod sizes;
#[path = "rendered/tags.rs"]
mod tags;

use std::f64::consts::TAU;

use boresight_camera::{Camera, Model};
use boresight_data::{Geometry, GrayImage, GrayPixels, PointId, Shape, Target};
use boresight_detect::{Detection, Missed, detect};
use boresight_geometry::nalgebra::Unit;
use boresight_geometry::{Pose, UnitQuaternion, Vector3};
use boresight_synthetic::{Depth, Exposure, render};

fn camera() -> Camera {
    let params = vec![520.0, 522.0, 322.0, 238.0, -0.2, 0.06, 4e-4, -3e-4, 0.0];
    Camera { model: Model::OpenCv5(Default::default()), params, image_size: [640, 480] }
}

fn board(columns: u32, rows: u32) -> Target {
    let geometry = Geometry::Chessboard { columns, rows, spacing_m: 0.03 };
    Target { name: "board".to_owned(), geometry, shape: Shape::Rigid }
}

/// Returns the pose of a 9x6 board: its middle in the camera's frame, tilted about an axis across, then rolled.
fn pose(middle: [f64; 3], tilt_deg: f64, axis_turns: f64, roll_deg: f64) -> Pose {
    let (sin, cos) = (axis_turns * TAU).sin_cos();
    let tilt_axis = Unit::new_normalize(Vector3::new(cos, sin, 0.0));
    let rotation = UnitQuaternion::from_axis_angle(&tilt_axis, tilt_deg.to_radians())
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_deg.to_radians());
    Pose::new(rotation, Vector3::from(middle) - rotation * Vector3::new(0.12, 0.075, 0.0))
}

fn truth(camera: &Camera, cam_from_target: &Pose, target: &Target, point: PointId) -> [f64; 2] {
    camera
        .project(&(*cam_from_target * target.drawn_point(point)))
        .expect("the board is in front of the camera")
}

/// Returns the errors of all corners, each of which must be where it is labelled to within half a pixel.
fn errors(found: &Detection, camera: &Camera, cam_from_target: &Pose, target: &Target) -> Vec<[f64; 2]> {
    let error = |observation: &boresight_data::Observation| {
        let truth = truth(camera, cam_from_target, target, observation.point);
        let error = [0, 1].map(|axis| observation.pixel[axis] - truth[axis]);
        assert!(error[0].hypot(error[1]) < 0.5, "{observation:?} is at {truth:?}");
        error
    };
    found.observations.iter().map(error).collect()
}

#[test]
fn corners_are_exact_and_their_sigmas_true() {
    let (camera, target) = (camera(), board(9, 6));
    let (mut all, mut variances) = (Vec::new(), 0.0);
    for i in 0..16u32 {
        let t = f64::from(i);
        let tilt_deg = 60.0 * (t + 0.5) / 16.0;
        let middle = [0.03 * (1.7 * t).sin(), 0.02 * (2.3 * t).cos(), 0.46 + 0.08 * (0.9 * t).sin()];
        let pose = pose(middle, tilt_deg, 0.37 * t, 50.0 * (1.3 * t).sin());
        let blur_px = [0.0, 0.6, 1.0, 1.5][i as usize % 4];
        let noise = [1.0, 2.0, 4.0, 6.0][i as usize / 4];
        let exposure = Exposure { blur_px, noise, ..Exposure::default() };
        let image = render(&camera, &pose, &target, &[], &exposure, u64::from(i)).unwrap();
        let found = detect(&image, &target);
        assert_eq!((found.observations.len(), found.missed), (54, None), "image {i}");
        all.extend(errors(&found, &camera, &pose, &target));
        variances += found.observations.iter().map(|observation| observation.sigma_px.powi(2)).sum::<f64>();
        assert_eq!(detect(&image, &target), found);
    }
    let n = all.len() as f64;
    let bias = [0, 1].map(|axis| all.iter().map(|error| error[axis]).sum::<f64>() / n);
    let rms = (all.iter().flatten().map(|e| e * e).sum::<f64>() / (2.0 * n)).sqrt();
    let ratio = rms / (variances / n).sqrt();
    println!("bias {bias:?} px, rms {rms:.4} px, of the stated sigma {ratio:.3}");
    assert!(bias.iter().all(|bias| bias.abs() < 0.005), "{bias:?}");
    assert!(rms < 0.035, "{rms}");
    assert!((ratio - 1.0).abs() < 0.2, "{ratio}");
}

#[test]
fn boards_cut_by_the_border_have_no_false_corner() {
    let (camera, target) = (camera(), board(9, 6));
    let mut n_found = 0;
    let n = 24u32;
    for i in 0..n {
        let t = f64::from(i);
        // Far enough to one side for a part of the board to be out of the image.
        let (sin, cos) = (t / f64::from(n) * TAU).sin_cos();
        let middle = [0.22 * cos, 0.17 * sin, 0.40];
        let pose = pose(middle, 25.0, 0.37 * t, 40.0 * (1.3 * t).sin());
        let image = render(&camera, &pose, &target, &[], &Exposure::default(), u64::from(i)).unwrap();
        let found = detect(&image, &target);
        errors(&found, &camera, &pose, &target);
        assert!(found.observations.len() < 54, "image {i} shows the whole board");
        n_found += u32::from(found.observations.len() >= 8);
    }
    println!("{n_found} of {n} cut boards are used");
    assert!(n_found >= n * 2 / 3, "{n_found} of {n}");
}

#[test]
fn sixteen_bits_and_other_sizes_of_image_do_as_well() {
    for (scale, depth) in [(0.5, Depth::Eight), (2.5, Depth::Sixteen)] {
        let Camera { model, params, image_size } = camera();
        let params = params.iter().enumerate().map(|(i, p)| if i < 4 { p * scale } else { *p }).collect();
        let image_size = image_size.map(|side| (f64::from(side) * scale) as u32);
        let camera = Camera { model, params, image_size };
        let pose = pose([0.0, 0.0, 0.45], 30.0, 0.1, 190.0);
        let exposure = Exposure { depth, blur_px: 1.0, ..Exposure::default() };
        let image = render(&camera, &pose, &board(9, 6), &[], &exposure, 3).unwrap();
        let found = detect(&image, &board(9, 6));
        assert_eq!(found.observations.len(), 54, "scale {scale}");
        let errors = errors(&found, &camera, &pose, &board(9, 6));
        assert!(errors.iter().flatten().all(|error| error.abs() < 0.15), "scale {scale}: {errors:?}");
    }
}

#[test]
fn what_is_not_the_target_is_told() {
    let camera = camera();
    let pose = pose([0.0, 0.0, 0.5], 20.0, 0.1, 10.0);
    let image = render(&camera, &pose, &board(9, 6), &[], &Exposure::default(), 3).unwrap();
    let seen = Missed::OtherSize { columns: 9, rows: 6 };
    for (columns, rows, expected) in [
        (9, 6, None),
        (6, 9, None),
        (8, 6, Some(seen)),
        (10, 6, Some(seen)),
        (9, 7, Some(seen)),
        (7, 9, Some(seen)),
        (10, 7, Some(seen)),
        (9, 5, Some(seen)),
        (12, 9, Some(seen)),
    ] {
        assert_eq!(detect(&image, &board(columns, rows)).missed, expected, "{columns}x{rows}");
    }
    let points = Target { geometry: Geometry::Points { points_m: vec![[0.0; 3]] }, ..board(9, 6) };
    assert_eq!(detect(&image, &points).missed, Some(Missed::NoDetector));
    for size in [[0, 0], [1, 1], [3, 200], [64, 64]] {
        let plain = GrayImage::new(size, GrayPixels::Eight(vec![7; (size[0] * size[1]) as usize])).unwrap();
        assert_eq!(detect(&plain, &board(9, 6)).missed, Some(Missed::NoBoard), "{size:?}");
    }
}

#[test]
fn half_a_turn_is_told_by_colours() {
    let camera = camera();
    for roll_deg in [0.0, 90.0, 180.0, 270.0] {
        let pose = pose([0.0, 0.0, 0.5], 20.0, 0.1, roll_deg);
        let image = render(&camera, &pose, &board(9, 6), &[], &Exposure::default(), 3).unwrap();
        let found = detect(&image, &board(9, 6));
        assert_eq!(errors(&found, &camera, &pose, &board(9, 6)).len(), 54, "{roll_deg}");
    }
}
