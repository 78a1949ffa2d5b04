//! Seeds of scenes with known truth.

use boresight_data::{CameraId, Dataset, Geometry, Id as _, Scene, Shape, Target, TargetId};
use boresight_geometry::Pose;
use boresight_seed::{Error, LeftOut, Seed, SeedOptions, seed};
use boresight_synthetic::{Outliers, Placement, Recipe, Synthetic, simulate};

use crate::support::{reprojection, seed_with};

/// Returns the largest difference of pose of any camera, in radians and metres.
fn rig_error(found: &Scene, truth: &Scene) -> (f64, f64) {
    let pairs = found.rig.cameras.iter().flatten().zip(truth.rig.cameras.iter().flatten());
    pairs.fold((0.0, 0.0), |(angle, length), (found, truth)| {
        let error: Pose = found.cam_from_rig * truth.cam_from_rig.inverse();
        (f64::max(angle, error.angle()), f64::max(length, error.translation.norm()))
    })
}

/// Seeds a recipe's scenes and checks focal lengths (relative) and the median residual (in sigmas).
fn check(label: &str, recipe: &Recipe, seeds: std::ops::Range<u64>, focal_tolerance: f64) {
    for seed in seeds {
        let made = simulate(recipe, seed);
        let (seeded, _) = seed_of(label, recipe, &made);
        for (found, truth) in seeded.scene.rig.cameras.iter().zip(&made.truth.rig.cameras) {
            let (found, truth) = (&found.as_ref().unwrap().camera, &truth.as_ref().unwrap().camera);
            let error = found.params[0] / truth.params[0] - 1.0;
            assert!(error.abs() < focal_tolerance, "{label} {seed}: focal length off by {error}");
        }
        let (_, median, _) = reprojection(&made.dataset, &seeded.scene, &seeded.left_out);
        // The median length of two-dimensional unit noise is 1.18; the flat board adds to it.
        assert!(median < 3.0 * recipe.sigma_px, "{label} {seed}: {median}");
    }
}

fn seed_of(label: &str, recipe: &Recipe, made: &Synthetic) -> (Seed, usize) {
    let seeded = seed_with(label, &made.dataset, recipe.cameras[0].camera.model.name());
    let n_views_out = seeded.left_out.iter().filter(|fact| fact.view_idx().is_some()).count();
    (seeded, n_views_out)
}

fn with_outliers(recipe: Recipe, share: f64) -> Recipe {
    Recipe { outliers: Outliers { share, sigma_px: 40.0 }, ..recipe }
}

#[test]
fn mono() {
    check("mono", &Recipe::mono(), 0..10, 0.01);
    check("mono, outliers", &with_outliers(Recipe::mono(), 0.05), 0..10, 0.01);
}

#[test]
fn fisheye() {
    check("fisheye", &Recipe::fisheye(), 0..10, 0.01);
    check("fisheye, outliers", &with_outliers(Recipe::fisheye(), 0.05), 0..10, 0.01);
}

#[test]
fn narrow() {
    let mut recipe = Recipe::mono();
    let lens = &mut recipe.cameras[0].camera;
    lens.params = vec![6000.0, 6005.0, 780.0, 610.0, -0.3, 0.4, 0.0, 0.0, 0.0];
    recipe.placement.distance_m = [4.0, 7.0];
    check("narrow", &recipe, 0..10, 0.03);
    check("narrow, outliers", &with_outliers(recipe, 0.03), 0..10, 0.03);
}

#[test]
fn off_centre() {
    let mut recipe = Recipe::mono();
    recipe.cameras[0].camera.params[2] = 1000.0;
    recipe.cameras[0].camera.params[3] = 480.0;
    check("off centre", &recipe, 0..10, 0.02);
}

#[test]
fn few_views() {
    let recipe = Recipe { frames: 3, ..Recipe::mono() };
    check("three views", &recipe, 0..20, 0.05);
    let recipe = Recipe { frames: 3, ..Recipe::fisheye() };
    check("three fisheye views", &recipe, 0..20, 0.05);
}

#[test]
fn nearly_frontal() {
    let mut recipe = Recipe::mono();
    recipe.placement = Placement { tilt_rad: 0.1, ..recipe.placement };
    check("nearly frontal", &recipe, 0..10, 0.1);
}

#[test]
fn partial_boards() {
    let mut recipe = Recipe { hidden_share: 0.3, ..Recipe::mono() };
    recipe.placement.image_share = 1.0;
    recipe.placement.distance_m = [0.3, 0.7];
    check("partial", &recipe, 0..10, 0.01);
    check("partial, outliers", &with_outliers(recipe.clone(), 0.03), 0..10, 0.01);
}

#[test]
fn a_solid_target() {
    let mut recipe = Recipe::mono();
    let points = (0..60).map(|i| {
        let i = f64::from(i);
        [0.2 * (i * 1.7).sin(), 0.2 * (i * 2.9 + 1.0).sin(), 0.1 * (i * 0.7 + 2.0).sin()]
    });
    recipe.target = Target {
        name: "solid".into(),
        geometry: Geometry::Points { points_m: points.collect() },
        shape: Shape::Rigid,
    };
    recipe.shape_m.clear();
    check("solid", &recipe, 0..10, 0.01);
}

#[test]
fn rigs() {
    for (label, recipe) in
        [("stereo", Recipe::stereo()), ("ring", Recipe::ring(4)), ("ring", Recipe::ring(8))]
    {
        for (seed, share) in [(0, 0.0), (1, 0.0), (2, 0.03), (3, 0.03)] {
            let recipe = with_outliers(recipe.clone(), share);
            let made = simulate(&recipe, seed);
            let (seeded, n_out) = seed_of(label, &recipe, &made);
            let (angle, length) = rig_error(&seeded.scene, &made.truth);
            println!("    rig error {angle:.5} rad {length:.5} m");
            assert!(angle < 0.03 && length < 0.04, "{label} {seed}: {angle} rad {length} m");
            assert_eq!(n_out, 0);
        }
    }
}

#[test]
fn a_camera_without_shared_frames_is_named() {
    let made = simulate(&Recipe::stereo(), 0);
    let mut dataset = made.dataset.clone();
    dataset.views.retain(|view| (view.frame.index() < 8) == (view.camera.index() == 1));
    let seeded = seed_with("unconnected", &dataset, "opencv5");
    let right_views = dataset.views.iter().filter(|view| view.camera.index() == 1).count();
    assert_eq!(seeded.left_out, [LeftOut::Unconnected { camera: CameraId(1), views: right_views, kept: 1 }]);
    assert!(seeded.scene.rig.cameras[CameraId(1)].is_none());
}

#[test]
fn two_targets_seen_together() {
    let made = simulate(&Recipe::stereo(), 1);
    // The board is sawn in two; each half keeps the board's frame, and they are seen by different
    // cameras in every third frame.
    let mut dataset = made.dataset.clone();
    let points_m: Vec<[f64; 3]> =
        (0..80).map(|i| [f64::from(i % 10) * 0.05, f64::from(i / 10) * 0.05, 0.0]).collect();
    let half = |name: &str| Target {
        name: name.into(),
        geometry: Geometry::Points { points_m: points_m.clone() },
        shape: Shape::Rigid,
    };
    dataset.targets = vec![half("left half"), half("right half")].into();
    dataset.views.clear();
    for view in &made.dataset.views {
        for target in 0..2 {
            if view.frame.index() % 3 == 0 && view.camera.index() != target {
                continue;
            }
            let mut part = view.clone();
            part.target = TargetId::from_index(target);
            part.observations.retain(|observation| (observation.point.0 % 10 >= 5) == (target == 1));
            dataset.views.push(part);
        }
    }
    let seeded = seed_with("two targets", &dataset, "opencv5");
    let is_cut_off = |fact: &LeftOut| matches!(fact, LeftOut::TooFewPoints { .. });
    assert!(seeded.left_out.iter().all(is_cut_off), "{:?}", seeded.left_out);
    let first_from_second = seeded.scene.targets[TargetId(1)].first_from_target;
    // The halves are taken for flat and rigid, the real board is bowed by 0.8 mm.
    assert!(first_from_second.angle() < 0.02, "{first_from_second:?}");
    assert!(first_from_second.translation.norm() < 0.005, "{first_from_second:?}");
}

#[test]
fn a_view_from_the_wrong_instant_is_named() {
    let mut dataset = simulate(&Recipe::stereo(), 4).dataset;
    // The right camera's images of two frames are swapped.
    let right: Vec<usize> =
        (0..dataset.views.len()).filter(|&i| dataset.views[i].camera.index() == 1).collect();
    let taken = std::mem::take(&mut dataset.views[right[2]].observations);
    dataset.views[right[2]].observations =
        std::mem::replace(&mut dataset.views[right[7]].observations, taken);
    let seeded = seed_with("swapped", &dataset, "opencv5");
    let named: Vec<_> = seeded.left_out.iter().map(|fact| (fact.view_idx(), fact)).collect();
    assert_eq!(named.len(), 2, "{named:?}");
    assert!(named.iter().all(|(_, fact)| matches!(fact, LeftOut::BadFit { .. })), "{named:?}");
    let frames = named.iter().map(|(view_idx, _)| dataset.views[view_idx.unwrap()].frame);
    assert_eq!(frames.collect::<Vec<_>>(), [dataset.views[right[2]].frame, dataset.views[right[7]].frame]);
}

#[test]
fn unusable_datasets_are_errors_with_numbers() {
    let dataset = simulate(&Recipe { frames: 2, ..Recipe::mono() }, 0).dataset;
    let options = SeedOptions { models: vec!["opencv5".parse().unwrap()], ..SeedOptions::default() };
    let few = Error::TooFewViews { camera: "cam0".into(), found: 2, need: 3 };
    assert_eq!(seed(&dataset, &options).unwrap_err(), few);
    let none = Dataset { views: Vec::new(), ..dataset.clone() };
    assert_eq!(seed(&none, &options).unwrap_err(), Error::NoViews { cameras: 1, frames: 2 });
    let models = SeedOptions { models: Vec::new(), ..options };
    assert_eq!(seed(&dataset, &models).unwrap_err(), Error::ModelCount { found: 0, cameras: 1 });
}

/// Prints how good seeds are over fifty scenes of each kind;
/// `cargo test --release -p boresight-seed -- --ignored --nocapture survey`.
#[test]
#[ignore = "prints figures; the tests above check a few scenes of each kind"]
fn survey() {
    let narrow = || {
        let mut recipe = Recipe::mono();
        recipe.cameras[0].camera.params = vec![6000.0, 6005.0, 780.0, 610.0, -0.3, 0.4, 0.0, 0.0, 0.0];
        recipe.placement.distance_m = [4.0, 7.0];
        recipe
    };
    let mut near_frontal_far = Recipe::mono();
    near_frontal_far.placement =
        Placement { tilt_rad: 0.15, distance_m: [1.5, 2.5], ..near_frontal_far.placement };
    let mut partial_fish = Recipe { hidden_share: 0.4, min_points: 8, ..Recipe::fisheye() };
    partial_fish.placement.image_share = 1.0;
    let cases = [
        ("fish3", Recipe { frames: 3, ..Recipe::fisheye() }),
        ("fish5", Recipe { frames: 5, ..Recipe::fisheye() }),
        ("fish5out", with_outliers(Recipe { frames: 5, ..Recipe::fisheye() }, 0.05)),
        ("fish20out", with_outliers(Recipe::fisheye(), 0.05)),
        ("partialfish", with_outliers(partial_fish, 0.03)),
        ("mono3", Recipe { frames: 3, ..Recipe::mono() }),
        ("mono3out", with_outliers(Recipe { frames: 3, ..Recipe::mono() }, 0.05)),
        ("mono20out10", with_outliers(Recipe::mono(), 0.10)),
        ("narrow", narrow()),
        ("narrowout", with_outliers(narrow(), 0.03)),
        ("narrow5", Recipe { frames: 5, ..narrow() }),
        ("frontalfar", near_frontal_far),
        ("ring8out", with_outliers(Recipe::ring(8), 0.05)),
    ];
    for (label, recipe) in cases {
        let (mut errors, mut medians, mut worst) = (Vec::new(), Vec::new(), Vec::new());
        let mut n_out = 0;
        for number in 100..150 {
            let made = simulate(&recipe, number);
            let options = SeedOptions { models: vec![recipe.cameras[0].camera.model], ..Default::default() };
            let Ok(seeded) = seed(&made.dataset, &options) else {
                worst.push((number, 9.9));
                continue;
            };
            n_out += seeded.left_out.len();
            for (found, truth) in seeded.scene.rig.cameras.iter().zip(&made.truth.rig.cameras) {
                let Some(found) = found.as_ref() else { continue };
                let truth = truth.as_ref().unwrap();
                let error = (found.camera.params[0] / truth.camera.params[0] - 1.0).abs();
                errors.push(error);
                if error > 0.05 {
                    worst.push((number, error));
                }
            }
            medians.push(reprojection(&made.dataset, &seeded.scene, &seeded.left_out).1);
        }
        errors.sort_by(f64::total_cmp);
        medians.sort_by(f64::total_cmp);
        println!(
            "{label}: focal error median {:.4} 90% {:.4}; residual median {:.3} 90% {:.3} max {:.3}; out {n_out} bad {worst:.2?}",
            errors[errors.len() / 2],
            errors[errors.len() * 9 / 10],
            medians[medians.len() / 2],
            medians[medians.len() * 9 / 10],
            medians[medians.len() - 1]
        );
    }
}
