//! ChArUco boards and AprilGrids.

use boresight_camera::Camera;
use boresight_data::{Dictionary, Geometry, GrayImage, GrayPixels, PointId, Shape, Target};
use boresight_detect::{Detection, Missed, Pattern, detect};
use boresight_geometry::{Pose, Vector3};
use boresight_synthetic::{Exposure, FirstSquare, Print, render};

use super::{camera, errors, pose, truth};

fn charuco(columns: u32, rows: u32, dictionary: &str) -> Target {
    let dictionary = Dictionary::named(dictionary).expect("there is this dictionary");
    let geometry = Geometry::Charuco { columns, rows, spacing_m: 0.04, marker_m: 0.03, dictionary };
    Target { name: "board".to_owned(), geometry, shape: Shape::Rigid }
}

fn april_grid(columns: u32, rows: u32) -> Target {
    let dictionary = Dictionary::APRILTAG_36H11;
    let geometry = Geometry::AprilGrid { columns, rows, tag_m: 0.088, spacing: 0.3, dictionary };
    Target { name: "grid".to_owned(), geometry, shape: Shape::Rigid }
}

/// Returns a camera with more pixels.
fn large(scale: f64) -> Camera {
    let Camera { model, params, image_size } = camera();
    let params = params.iter().enumerate().map(|(i, p)| if i < 4 { p * scale } else { *p }).collect();
    Camera { model, params, image_size: image_size.map(|side| (f64::from(side) * scale) as u32) }
}

/// Returns the pose of a target with its middle at a place, tilted and rolled, with its front to the camera.
pub(super) fn facing(
    target: &Target,
    middle: [f64; 3],
    tilt_deg: f64,
    axis_turns: f64,
    roll_deg: f64,
) -> Pose {
    let last = target.drawn_point(PointId(target.point_count() as u32 - 1));
    let mut rotation = pose([0.0; 3], tilt_deg, axis_turns, roll_deg).rotation;
    if matches!(target.geometry, Geometry::AprilGrid { .. }) {
        // Its z is towards the camera.
        rotation *=
            Pose::from_rodrigues(Vector3::new(std::f64::consts::PI, 0.0, 0.0), Vector3::zeros()).rotation;
    }
    Pose::new(rotation, Vector3::from(middle) - rotation * (0.5 * last))
}

/// Covers a share of the points of a target with grey discs.
fn cover(image: &GrayImage, places: &[[f64; 2]], radius_px: f64) -> GrayImage {
    let [width, _] = image.size().map(|side| side as usize);
    let GrayPixels::Eight(values) = image.pixels() else { panic!("eight bits are the default") };
    let mut values = values.clone();
    for (i, value) in values.iter_mut().enumerate() {
        let at = [(i % width) as f64, (i / width) as f64];
        if places.iter().any(|place| (at[0] - place[0]).hypot(at[1] - place[1]) < radius_px) {
            *value = 128;
        }
    }
    GrayImage::new(image.size(), GrayPixels::Eight(values)).expect("as many values as pixels")
}

pub(super) fn root_mean_square(errors: &[[f64; 2]]) -> f64 {
    (errors.iter().flatten().map(|e| e * e).sum::<f64>() / (2.0 * errors.len() as f64)).sqrt()
}

#[test]
fn charuco_corners_are_exact_and_both_patterns_are_told() {
    let camera = large(1.4);
    let (mut all, mut variances) = (Vec::new(), 0.0);
    for i in 0..6u32 {
        let t = f64::from(i);
        let (dictionary, rows) = [("5x5_1000", 8), ("4x4_50", 9), ("36h11", 6)][i as usize % 3];
        let target = charuco(if rows == 9 { 7 } else { 10 }, rows, dictionary);
        let first_square = if i % 2 == 0 { FirstSquare::White } else { FirstSquare::Dark };
        let exposure = Exposure {
            print: Print { first_square, ..Print::default() },
            blur_px: [0.4, 0.8, 1.2, 0.6][i as usize % 4],
            noise: [1.0, 2.0, 4.0][i as usize % 3],
            ..Exposure::default()
        };
        let middle = [0.03 * (1.7 * t).sin(), 0.02 * (2.3 * t).cos(), 0.55 + 0.06 * (0.9 * t).sin()];
        let pose = facing(&target, middle, 45.0 * (t + 0.5) / 6.0, 0.37 * t, 170.0 * (1.3 * t).sin());
        let image = render(&camera, &pose, &target, &[], &exposure, u64::from(i)).unwrap();
        let found = detect(&image, &target);
        if rows == 9 && first_square == FirstSquare::White {
            // Such a board has no name: its rows are odd, so that only a board of even rows begins like this.
            assert!(found.observations.is_empty(), "image {i}: {found:?}");
            continue;
        }
        let pattern = if first_square == FirstSquare::White { Pattern::Legacy } else { Pattern::Current };
        assert_eq!((found.missed, found.pattern), (None, Some(pattern)), "image {i}");
        assert_eq!(found.observations.len(), target.point_count(), "image {i}");
        let of_image = errors(&found, &camera, &pose, &target);
        all.extend(of_image);
        variances += found.observations.iter().map(|observation| observation.sigma_px.powi(2)).sum::<f64>();
    }
    let rms = root_mean_square(&all);
    let ratio = rms / (variances / all.len() as f64).sqrt();
    println!("rms {rms:.4} px, of the stated sigma {ratio:.3}");
    assert!(rms < 0.035, "{rms}");
    assert!((ratio - 1.0).abs() < 0.3, "{ratio}");
}

/// Checks a board of which a third of the corners is covered; returns how many of those to be seen are found.
fn check_covered(target: &Target, camera: &Camera, pose: &Pose, seed: u64, radius_px: f64) -> [usize; 2] {
    let image =
        render(camera, pose, target, &[], &Exposure::default(), seed).expect("the board can be drawn");
    let n = target.point_count();
    let hash = |i: usize| (i as u64 * 2_654_435_761 + seed * 40_503) % 1009;
    let hidden: Vec<usize> = (0..n).filter(|i| hash(*i) < 303).collect();
    let place = |i: &usize| truth(camera, pose, target, PointId(*i as u32));
    let places: Vec<[f64; 2]> = hidden.iter().map(place).collect();
    let found = detect(&cover(&image, &places, radius_px), target);
    // Every corner is where it is labelled, and none is seen under a disc.
    errors(&found, camera, pose, target);
    for observation in &found.observations {
        assert!(!hidden.contains(&(observation.point.0 as usize)), "{observation:?} is covered");
    }
    [found.observations.len(), n - hidden.len()]
}

#[test]
fn charuco_with_a_third_of_its_corners_covered_has_no_false_one() {
    let (camera, target) = (large(1.4), charuco(10, 7, "5x5_1000"));
    let (mut n_found, mut n_seen) = (0, 0);
    for i in 0..3u32 {
        let t = f64::from(i);
        let pose = facing(&target, [0.0, 0.0, 0.52], 15.0 * t, 0.37 * t, 40.0 * t);
        let [found, seen] = check_covered(&target, &camera, &pose, u64::from(i), 9.0);
        (n_found, n_seen) = (n_found + found, n_seen + seen);
    }
    println!("{n_found} of {n_seen} corners to be seen are found");
    assert!(10 * n_found >= 8 * n_seen, "{n_found} of {n_seen}");
}

#[test]
fn markers_of_another_board_are_told_and_never_labelled() {
    let camera = large(1.6);
    let printed = charuco(10, 7, "5x5_1000");
    let pose = facing(&printed, [0.0, 0.0, 0.52], 20.0, 0.1, 10.0);
    let image = render(&camera, &pose, &printed, &[], &Exposure::default(), 3).unwrap();
    let seen = |columns, rows, dictionary: &str| detect(&image, &charuco(columns, rows, dictionary));
    let other = Some(Missed::OtherSquares { columns: 10, rows: 7 });
    let told = |found: Detection| {
        assert!(found.observations.is_empty(), "{found:?}");
        found.missed
    };
    assert_eq!(told(seen(7, 10, "5x5_1000")), other);
    assert_eq!(told(seen(9, 7, "5x5_1000")), other);
    assert_eq!(told(seen(11, 7, "5x5_1000")), other);
    assert_eq!(told(seen(10, 5, "5x5_1000")), other);
    let dictionary = Dictionary::named("5x5_50").unwrap();
    assert_eq!(told(seen(10, 7, "4x4_50")), Some(Missed::OtherDictionary(dictionary)));
    assert_eq!(seen(10, 7, "5x5_100").observations.len(), 54);
    assert_eq!(told(seen(10, 6, "5x5_1000")), other);
    // A row too many changes no label.
    let found = seen(10, 8, "5x5_1000");
    assert_eq!(found.pattern, Some(Pattern::Current));
    assert_eq!(errors(&found, &camera, &pose, &charuco(10, 8, "5x5_1000")).len(), 54);
    // Nor is a chessboard taken for one.
    let plain = Target { geometry: Geometry::Chessboard { columns: 9, rows: 6, spacing_m: 0.04 }, ..printed };
    let image = render(&camera, &pose, &plain, &[], &Exposure::default(), 3).unwrap();
    assert_eq!(detect(&image, &charuco(10, 7, "5x5_1000")).missed, Some(Missed::NoMarkers { corners: 54 }));
}

#[test]
fn legacy_boards_are_told_whatever_is_declared() {
    let camera = large(1.6);
    let printed = charuco(10, 8, "5x5_1000");
    let pose = facing(&printed, [0.0, 0.0, 0.56], 20.0, 0.1, 10.0);
    let print = Print { first_square: FirstSquare::White, ..Print::default() };
    let exposure = Exposure { print, ..Exposure::default() };
    let image = render(&camera, &pose, &printed, &[], &exposure, 3).unwrap();
    let seen = |columns, rows| detect(&image, &charuco(columns, rows, "5x5_1000"));
    // As declared, and with two rows too many, of which labels do not depend.
    for rows in [8, 10] {
        let found = seen(10, rows);
        assert_eq!((found.pattern, found.missed), (Some(Pattern::Legacy), None), "{rows} rows");
        assert_eq!(errors(&found, &camera, &pose, &charuco(10, rows, "5x5_1000")).len(), 63);
    }
    // Columns and rows swapped, one too many or too few; with an odd number of rows there is no legacy pattern.
    for (columns, rows) in [(8, 10), (11, 8), (9, 8), (10, 9), (10, 7)] {
        let found = seen(columns, rows);
        assert_eq!((found.observations.len(), found.pattern), (0, None), "{columns}x{rows}");
        let told = Some(Missed::OtherSquares { columns: 10, rows: 8 });
        assert_eq!(found.missed, told, "{columns}x{rows}");
    }
}

#[test]
fn april_grids_are_found_whole_cropped_and_covered() {
    let camera = large(1.6);
    let target = april_grid(5, 4);
    let mut all = Vec::new();
    let mut variances = 0.0;
    for i in 0..4u32 {
        let t = f64::from(i);
        let exposure = Exposure {
            print: Print { tag_border: 1 + i as usize % 2, ..Print::default() },
            margin_squares: 0.4,
            blur_px: [0.4, 0.8, 1.2][i as usize % 3],
            noise: [1.0, 3.0][i as usize % 2],
            ..Exposure::default()
        };
        let pose = facing(&target, [0.02, -0.01, 0.75], 6.0 + 12.0 * t, 0.37 * t, 11.0 + 77.0 * t);
        let image = render(&camera, &pose, &target, &[], &exposure, u64::from(i)).unwrap();
        let found = detect(&image, &target);
        println!("image {i}: {} of 80, {:?}", found.observations.len(), found.missed);
        assert!(found.observations.len() >= 78, "image {i}");
        let of_image = errors(&found, &camera, &pose, &target);
        let of_sigmas =
            found.observations.iter().map(|observation| observation.sigma_px.powi(2)).sum::<f64>();
        let sigma = (of_sigmas / of_image.len() as f64).sqrt();
        println!("image {i}: rms {:.4}, sigma {sigma:.4}", root_mean_square(&of_image));
        all.extend(of_image);
        variances += of_sigmas;
    }
    let rms = root_mean_square(&all);
    let ratio = rms / (variances / all.len() as f64).sqrt();
    println!("rms {rms:.4} px, of the stated sigma {ratio:.3}");
    assert!(rms < 0.05, "{rms}");
    assert!((ratio - 1.0).abs() < 0.3, "{ratio}");
    for i in 0..3u32 {
        let t = f64::from(i);
        let (sin, cos) = (2.1 * t).sin_cos();
        let pose = facing(&target, [0.32 * cos, 0.25 * sin, 0.6], 4.0 * t, 0.37 * t, 40.0 * t);
        let image = render(&camera, &pose, &target, &[], &Exposure::default(), u64::from(i)).unwrap();
        let found = detect(&image, &target);
        errors(&found, &camera, &pose, &target);
        assert!((20..80).contains(&found.observations.len()), "image {i}: {}", found.observations.len());
    }
    let pose = facing(&target, [0.0, 0.0, 0.7], 20.0, 0.1, 10.0);
    let [found, seen] = check_covered(&target, &camera, &pose, 1, 6.0);
    println!("{found} of {seen} corners to be seen are found");
    let image = render(&camera, &pose, &target, &[], &Exposure::default(), 3).unwrap();
    for (columns, rows) in [(4, 5), (6, 4), (5, 3)] {
        let expected = Some(Missed::OtherTags { columns: 5, rows: 4 });
        assert_eq!(detect(&image, &april_grid(columns, rows)).missed, expected, "{columns}x{rows}");
    }
    // A row too many changes no label.
    let found = detect(&image, &april_grid(5, 5));
    assert!(errors(&found, &camera, &pose, &april_grid(5, 5)).len() >= 78, "{:?}", found.missed);
}
