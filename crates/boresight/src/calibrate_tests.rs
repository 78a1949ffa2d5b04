//! Calibrations of synthetic recordings through the whole pipeline.

use boresight_geometry::Pose;
use boresight_synthetic::{PlacedCamera, Recipe, Synthetic, simulate};
use boresight_validate::{CompareOptions, Comparison, compare};

use super::*;

fn options(model: &str, shape: &str) -> CalibrateOptions {
    CalibrateOptions {
        model: model.parse().unwrap(),
        shape: shape.parse().unwrap(),
        ..CalibrateOptions::default()
    }
}

/// A lens that sees 140 degrees across the diagonal of 1600x1200, and a board of 560x360 mm.
fn wide(shape_m: Vec<f64>) -> Synthetic {
    wide_by(shape_m, 21)
}

fn wide_by(shape_m: Vec<f64>, seed: u64) -> Synthetic {
    let params = vec![800.0, 801.0, 803.0, 597.0, 0.02, -0.006, 0.001, -2e-4];
    let camera = Camera::new("kannala-brandt4".parse().unwrap(), params, [1600, 1200]).unwrap();
    let mut recipe = Recipe::fisheye();
    recipe.cameras = vec![PlacedCamera { name: "wide".to_owned(), camera, cam_from_rig: Pose::identity() }];
    recipe.target.geometry = Geometry::Chessboard { columns: 15, rows: 10, spacing_m: 0.04 };
    recipe.target.shape = if shape_m.len() > 2 { Shape::Twisted6 } else { Shape::Parabolic2 };
    recipe.shape_m = shape_m;
    recipe.frames = 40;
    simulate(&recipe, seed)
}

/// Returns what a wide recording is calibrated to with a choice of shape, and how far that lens is from the truth.
#[allow(clippy::print_stdout, reason = "a test says what it measured")]
fn calibrated(made: &Synthetic, shape: &str) -> (Comparison, Outcome) {
    let options = options("kannala-brandt4", shape);
    let outcome = calibrate(&Job::from(made.dataset.clone()), &options, &Watch::default()).unwrap();
    let [truth, found] = [&made.truth, &outcome.calibration.scene]
        .map(|scene| &scene.rig.cameras[CameraId(0)].as_ref().unwrap().camera);
    let difference = compare(truth, found, &CompareOptions::default()).unwrap();
    println!("shape {shape}: lens off by {:.3} px rms, {:.3} px max", difference.rms_px, difference.max_px);
    (difference, outcome)
}

#[test]
#[allow(clippy::print_stdout, reason = "a test says what it measured")]
fn a_bowed_board_does_not_bend_the_lens_where_its_shape_is_estimated() {
    let made = wide(vec![0.0005, 0.0]);
    let (with, outcome) = calibrated(&made, "auto");
    let shape = outcome.shape.clone().unwrap();
    println!("{}", shape.why);
    assert_eq!(shape.shape, Shape::Parabolic2, "{}", shape.why);
    assert!(with.rms_px <= 0.1 && with.max_px <= 0.2, "{} {}", with.rms_px, with.max_px);
    let (without, _) = calibrated(&made, "none");
    assert!(without.rms_px > with.rms_px, "{}", without.rms_px);
}

#[test]
fn trials_keep_to_what_is_held_and_known_and_end_when_they_are_stopped() {
    let made = simulate(&Recipe { frames: 10, ..Recipe::mono() }, 21);
    let lens = made.truth.rig.cameras[CameraId(0)].as_ref().unwrap().camera.clone();
    let stated =
        Job { known_lenses: vec![("cam0".to_owned(), lens.clone())], ..Job::from(made.dataset.clone()) };
    let outcome = calibrate(&stated, &options("auto", "auto"), &Watch::default()).unwrap();
    assert!(outcome.lenses.is_empty() && outcome.shape.is_some_and(|shape| shape.shape == Shape::Parabolic2));
    let cancel = Arc::new(AtomicBool::new(true));
    let watch = Watch { cancel: Some(cancel), observer: None };
    let stopped = calibrate(&Job::from(made.dataset.clone()), &options("auto", "2"), &watch).unwrap_err();
    assert!(matches!(stopped, Error::Cancelled), "{stopped}");
    // Points that bend in no known way have no shape to be tried.
    let mut points = Job::from(made.dataset);
    for target in points.dataset.targets.iter_mut() {
        let at = |i: usize| target.drawn_point(boresight_data::PointId::from_index(i)).into();
        target.geometry = Geometry::Points { points_m: (0..target.point_count()).map(at).collect() };
    }
    assert!(calibrate(&points, &options("opencv5", "auto"), &Watch::default()).unwrap().shape.is_none());
}

/// A twist of half a millimetre beside the bends.
const TWISTED_M: [f64; 6] = [3e-4, -2e-4, 5e-4, 1e-4, -2e-4, 1.5e-4];

#[test]
#[allow(clippy::print_stdout, reason = "a test says what it measured")]
fn a_twisted_board_is_recovered_and_does_not_bend_the_lens() {
    let made = wide(TWISTED_M.to_vec());
    let (six, outcome) = calibrated(&made, "auto");
    let selection = outcome.shape.unwrap();
    println!("{}", selection.why);
    assert_eq!(selection.shape, Shape::Twisted6, "{}", selection.why);
    assert!(six.rms_px <= 0.1 && six.max_px <= 0.2, "{} {}", six.rms_px, six.max_px);
    let found_m = &outcome.calibration.scene.targets.iter().next().unwrap().shape_m;
    for (j, (found, truth)) in found_m.iter().zip(TWISTED_M).enumerate() {
        let sigma = outcome.calibration.uncertainty.sigma(&format!("board.shape{j}_m")).unwrap();
        println!("shape{j}: {:.2} sigmas of {:.1} um", (found - truth) / sigma, 1e6 * sigma);
        // What is not known to a tenth of the twist would be within its sigmas by saying nothing.
        let is_known = sigma < 0.1 * TWISTED_M[2];
        assert!((found - truth).abs() <= 3.0 * sigma && is_known, "{j}: {found} {truth} {sigma}");
    }
    // What two coefficients leave is measured.
    let (two, _) = calibrated(&made, "2");
    assert!(two.rms_px > 2.0 * six.rms_px, "{} {}", two.rms_px, six.rms_px);
}

/// Heavy: `cargo test --release -p boresight --lib shapes_of_many -- --ignored --nocapture`.
#[test]
#[ignore = "thirty choices"]
#[allow(clippy::print_stdout, reason = "a test says what it measured")]
fn shapes_of_many_boards_are_told() {
    for shape_m in [vec![0.0, 0.0], vec![5e-4, -3e-4], TWISTED_M.to_vec()] {
        let chosen = (1..=10).map(|seed| {
            let made = wide_by(shape_m.clone(), seed);
            let options = options("kannala-brandt4", "auto");
            let outcome = calibrate(&Job::from(made.dataset), &options, &Watch::default()).unwrap();
            outcome.shape.unwrap().shape.coefficient_count()
        });
        let chosen: Vec<usize> = chosen.collect();
        println!("{shape_m:?}: {chosen:?}");
        let needed = if shape_m.len() > 2 { 6 } else { shape_m.iter().filter(|m| **m != 0.0).count() };
        assert!(chosen.iter().all(|n| *n >= needed), "{chosen:?}");
        assert!(chosen.iter().filter(|n| **n > needed).count() <= 2, "{chosen:?}");
    }
}

#[test]
fn a_flat_board_needs_no_shape() {
    let made = wide(vec![0.0, 0.0]);
    let options = options("kannala-brandt4", "auto");
    let outcome = calibrate(&Job::from(made.dataset), &options, &Watch::default()).unwrap();
    let shape = outcome.shape.clone().unwrap();
    assert_eq!(shape.shape, Shape::Rigid, "{}", shape.why);
    assert_eq!(outcome.dataset.targets.as_slice()[0].shape, Shape::Rigid);
}

#[test]
fn five_coefficients_on_a_wide_lens_never_look_fine() {
    let made = wide(vec![0.0, 0.0]);
    let outcome = calibrate(&Job::from(made.dataset), &options("opencv5", "2"), &Watch::default());
    // Either no start is found, or the verdict says that it fails.
    if let Ok(outcome) = outcome {
        assert_eq!(outcome.verdict, Verdict::Fail, "{:?}", outcome.findings);
    }
}

#[test]
fn cameras_may_have_lens_models_of_their_own() {
    let made = simulate(&Recipe::stereo(), 12);
    let watch = Watch::default();
    let outcome =
        calibrate(&Job::from(made.dataset.clone()), &options("opencv5,cam1=eucm", "2"), &watch).unwrap();
    let rig = &outcome.calibration.scene.rig.cameras;
    let names: Vec<&str> = rig.iter().map(|placed| placed.as_ref().unwrap().camera.model.name()).collect();
    assert_eq!(names, ["opencv5", "eucm"]);
    assert!(outcome.lenses.is_empty() && outcome.calibration.solve.converged);
    let unknown =
        calibrate(&Job::from(made.dataset), &options("opencv5,left=eucm", "2"), &watch).unwrap_err();
    assert!(unknown.to_string().contains("there is no camera `left`; known: cam0, cam1"), "{unknown}");
}

#[test]
fn a_lens_without_a_centre_is_refused_with_the_reason() {
    let made = simulate(&Recipe::mono(), 12);
    let refused =
        calibrate(&Job::from(made.dataset), &options("cahvore", "2"), &Watch::default()).unwrap_err();
    assert_eq!(refused.kind(), crate::ErrorKind::Usage);
    assert!(refused.to_string().contains("cahvore cannot be calibrated"), "{refused}");
    assert!(refused.hint().unwrap().contains("cahvor"), "{refused:?}");
}
#[test]
fn an_earlier_calibration_is_a_prior_and_its_uncertainty_carries_on() {
    let recipe = Recipe { frames: 30, ..Recipe::stereo() };
    let (first, second) = (simulate(&recipe, 5), simulate(&Recipe { frames: 6, ..recipe }, 6));
    let watch = Watch::default();
    let plain = CalibrateOptions::default();
    let earlier = calibrate(&Job::from(first.dataset), &plain, &watch).unwrap();
    let folder = tempfile::tempdir().unwrap();
    crate::write_results(&earlier, folder.path()).unwrap();
    let alone = calibrate(&Job::from(second.dataset.clone()), &plain, &watch).unwrap().calibration;
    let prior = CalibrateOptions { prior: Some(folder.path().to_owned()), ..plain.clone() };
    let both = calibrate(&Job::from(second.dataset.clone()), &prior, &watch).unwrap().calibration;
    let sigma = |calibration: &Calibration, name: &str| calibration.uncertainty.sigma(name);
    for name in ["cam0.fx", "cam1.cx", "cam1.cam_from_rig.tz_m"] {
        let [before, few, all] = [&earlier.calibration, &alone, &both].map(|c| sigma(c, name).unwrap());
        // More data, less uncertainty; the noise factors of both differ by a few percent.
        assert!(all < 1.05 * before && all < 0.8 * few, "{name}: {before} {few} {all}");
    }
    let held = CalibrateOptions { hold: vec!["lens".parse().unwrap()], ..prior };
    let held = calibrate(&Job::from(second.dataset), &held, &watch).unwrap().calibration;
    assert_eq!(sigma(&held, "cam0.fx"), None);
    let lens = |calibration: &Calibration| {
        calibration.scene.rig.cameras[CameraId(0)].as_ref().unwrap().camera.params.clone()
    };
    assert_eq!(lens(&held), lens(&earlier.calibration));
}

#[test]
fn what_an_earlier_calibration_held_is_held_again_and_stated_lenses_stay() {
    let recipe = Recipe { frames: 8, ..Recipe::stereo() };
    let made = [5, 6, 7].map(|seed| simulate(&recipe, seed).dataset);
    let watch = Watch::default();
    let folder = tempfile::tempdir().unwrap();
    let written = |outcome: &Outcome, name: &str| {
        crate::write_results(outcome, &folder.path().join(name)).unwrap();
        Some(folder.path().join(name))
    };
    let [first, second, third] = made.map(Job::from);
    let plain = calibrate(&first, &CalibrateOptions::default(), &watch).unwrap();
    let prior = written(&plain, "plain");
    let hold = vec!["lens".parse().unwrap(), "pose".parse().unwrap()];
    let options = CalibrateOptions { prior: prior.clone(), hold, ..CalibrateOptions::default() };
    let held = calibrate(&second, &options, &watch).unwrap();
    // It says nothing with a sigma, and all of it holds.
    let options = CalibrateOptions { prior: written(&held, "held"), ..CalibrateOptions::default() };
    let again = calibrate(&third, &options, &watch).unwrap();
    assert!(again.adjust.priors.is_empty());
    assert_eq!(again.calibration.scene.rig, plain.calibration.scene.rig);
    for name in ["cam0.fx", "cam1.k1", "cam1.cam_from_rig.tx_m"] {
        assert_eq!(again.calibration.uncertainty.sigma(name), None, "{name}");
    }

    // A lens that the job states is not the earlier calibration's; the other camera's is.
    let lens = |outcome: &Outcome, id: u32| {
        outcome.calibration.scene.rig.cameras[CameraId(id)].as_ref().unwrap().camera.clone()
    };
    let mut stated = lens(&plain, 1);
    stated.params[0] += 0.5;
    let third = Job { known_lenses: vec![("cam1".to_owned(), stated.clone())], ..third };
    let outcome =
        calibrate(&third, &CalibrateOptions { prior, ..CalibrateOptions::default() }, &watch).unwrap();
    assert_eq!(lens(&outcome, 1), stated);
    assert!(
        outcome.calibration.uncertainty.sigma("cam0.fx").unwrap()
            < 1.05 * plain.calibration.uncertainty.sigma("cam0.fx").unwrap()
    );
    assert!(outcome.calibration.uncertainty.sigma("cam1.cam_from_rig.tx_m").is_some());
}

#[test]
fn a_prior_weighs_as_much_where_corners_have_sigmas_of_their_own() {
    let recipe = Recipe { frames: 40, ..Recipe::mono() };
    // Every fourth corner is five times as good as the others.
    let mixed = |recipe: &Recipe, seed: u64| {
        let mut made = simulate(recipe, seed);
        for (view, clean_px) in made.dataset.views.iter_mut().zip(&made.clean_px) {
            for (i, (observation, clean_px)) in view.observations.iter_mut().zip(clean_px).enumerate() {
                let factor = if i % 4 == 0 { 0.4 } else { 2.0 };
                observation.sigma_px *= factor;
                for (pixel, clean_px) in observation.pixel.iter_mut().zip(clean_px) {
                    *pixel = clean_px + factor * (*pixel - clean_px);
                }
            }
        }
        made.dataset
    };
    let (watch, plain) = (Watch::default(), CalibrateOptions::default());
    let earlier = calibrate(&Job::from(mixed(&recipe, 5)), &plain, &watch).unwrap();
    let folder = tempfile::tempdir().unwrap();
    crate::write_results(&earlier, folder.path()).unwrap();
    let prior = CalibrateOptions { prior: Some(folder.path().to_owned()), ..plain };
    let few = mixed(&Recipe { frames: 4, ..recipe }, 6);
    let both = calibrate(&Job::from(few), &prior, &watch).unwrap().calibration;
    for name in ["cam0.fx", "cam0.cx", "cam0.k1"] {
        let [before, all] = [&earlier.calibration, &both].map(|c| c.uncertainty.sigma(name).unwrap());
        // A tenth more views tell little more; the noise factors of both differ by a few percent.
        assert!(all < 1.08 * before && all > 0.8 * before, "{name}: {before} {all}");
    }
}

#[test]
fn cameras_may_share_a_lens_and_parameters_may_be_held() {
    let mut recipe = Recipe::stereo();
    recipe.cameras[1].camera = recipe.cameras[0].camera.clone();
    let made = simulate(&recipe, 9);
    let options = CalibrateOptions {
        share_lens: vec!["cam0+cam1".to_owned()],
        hold: vec!["k3".parse().unwrap()],
        ..CalibrateOptions::default()
    };
    let outcome = calibrate(&Job::from(made.dataset), &options, &Watch::default()).unwrap();
    let rig = &outcome.calibration.scene.rig.cameras;
    let lens = |id: u32| rig[CameraId(id)].as_ref().unwrap().camera.params.clone();
    assert_eq!(lens(0), lens(1));
    assert_eq!(lens(0)[8], 0.0);
    assert!((lens(0)[0] - 1100.0).abs() < 3.0, "{:?}", lens(0));
    // As a prior, what it says of one lens twice counts once.
    let folder = tempfile::tempdir().unwrap();
    crate::write_results(&outcome, folder.path()).unwrap();
    for share_lens in [options.share_lens.clone(), Vec::new()] {
        let options = CalibrateOptions {
            prior: Some(folder.path().to_owned()),
            share_lens,
            ..CalibrateOptions::default()
        };
        let again =
            calibrate(&Job::from(simulate(&recipe, 10).dataset), &options, &Watch::default()).unwrap();
        assert_eq!(again.calibration.uncertainty.unavailable, None);
    }
    // Both halves hold and share the same.
    let halves = crate::cross_validation::halves(&outcome.dataset, &outcome.calibration, &outcome.adjust);
    for half in halves.unwrap() {
        let lens = |id: u32| &half.scene.rig.cameras[CameraId(id)].as_ref().unwrap().camera.params;
        assert_eq!((lens(0)[8], lens(0)), (0.0, lens(1)));
        assert_eq!(half.uncertainty.sigma("cam1.k3"), None);
    }
}

#[test]
fn the_regularization_of_a_shared_lens_counts_once() {
    let mut recipe = Recipe::stereo();
    recipe.cameras[1].camera = recipe.cameras[0].camera.clone();
    let options = CalibrateOptions {
        model: "opencv8".parse().unwrap(),
        share_lens: vec!["cam0+cam1".to_owned()],
        ..CalibrateOptions::default()
    };
    let outcome = calibrate(&Job::from(simulate(&recipe, 9).dataset), &options, &Watch::default()).unwrap();
    let uncertainty = &outcome.calibration.uncertainty;
    let claimed = |name: &str| {
        let place = uncertainty.names.iter().position(|known| known == name).unwrap();
        uncertainty.regularization_information[place]
    };
    // The coefficients of a rational lens are believed to a sigma of 2.
    assert_eq!(claimed("cam0.k4") + claimed("cam1.k4"), 0.25);
    let share = |name: &str| outcome.calibration.uncertainty.believed_share(name).unwrap();
    assert!(share("cam0.k4") == share("cam1.k4") && share("cam0.k4") > 0.0, "{}", share("cam0.k4"));
    assert_eq!(share("cam0.fx"), 0.0);
}

#[test]
fn what_is_told_of_one_camera_is_told_of_all_that_share_its_lens() {
    let mut recipe = Recipe::stereo();
    recipe.cameras[1].camera = recipe.cameras[0].camera.clone();
    let made = simulate(&recipe, 9);
    let share = CalibrateOptions { share_lens: vec!["cam1+cam0".to_owned()], ..CalibrateOptions::default() };
    let lens = |outcome: &Outcome, id: u32| {
        outcome.calibration.scene.rig.cameras[CameraId(id)].as_ref().unwrap().camera.clone()
    };
    // A parameter of the second camera is held where it says.
    let options = CalibrateOptions { hold: vec!["k3:cam1".parse().unwrap()], ..share.clone() };
    let held = calibrate(&Job::from(made.dataset.clone()), &options, &Watch::default()).unwrap();
    assert_eq!((lens(&held, 0).params[8], lens(&held, 1).params[8]), (0.0, 0.0));
    // A lens that is stated for the second camera is the first's too.
    let truth = recipe.cameras[0].camera.clone();
    let stated =
        Job { known_lenses: vec![("cam1".to_owned(), truth.clone())], ..Job::from(made.dataset.clone()) };
    let known = calibrate(&stated, &share, &Watch::default()).unwrap();
    assert_eq!((lens(&known, 0), lens(&known, 1)), (truth.clone(), truth));
    // Whatever is chosen for them is chosen once, of both cameras' views.
    let options = CalibrateOptions { model: "auto".parse().unwrap(), ..share.clone() };
    let chosen = calibrate(&Job::from(made.dataset.clone()), &options, &Watch::default()).unwrap();
    assert_eq!((chosen.lenses.len(), chosen.lenses[0].camera.as_str()), (1, "cam0+cam1"));
    assert_eq!(lens(&chosen, 0), lens(&chosen, 1));
    // Models that differ are refused before anything is fitted.
    let options = CalibrateOptions { model: "opencv5,cam1=eucm".parse().unwrap(), ..share };
    let refused = calibrate(&Job::from(made.dataset), &options, &Watch::default()).unwrap_err();
    assert_eq!(refused.kind(), crate::ErrorKind::Usage);
    assert!(refused.to_string().contains("it is opencv5 for one and eucm for the other"), "{refused}");
}
