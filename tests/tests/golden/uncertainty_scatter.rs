//! Sigmas and projection uncertainty against the scatter of noisy re-draws: one camera, two, four, and a
//! splined lens.

use std::time::Instant;

use boresight_adjust::{AdjustOptions, Hold, Rejection, adjust};
use boresight_camera::Camera;
use boresight_data::{Calibration, CameraId, Dataset, Scene};
use boresight_geometry::{Pose, Vector3, Vector6};
use boresight_seed::{ImpliedRotation, convert};
use boresight_synthetic::{Recipe, Synthetic, simulate};
use boresight_validate::{Method, ProjectionUncertainty, Propagation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal};

const SIGMA_PX: f64 = 0.3;
const GRID: [usize; 2] = [7, 5];
const DISTANCE_M: f64 = 2.0;

/// A parameter with a larger sigma than this share of what is believed of it beforehand is known by belief
/// alone, and has no scatter: a knot of a spline that hardly any corner is near.
const BELIEVED_SHARE: f64 = 0.05;

/// Returns the dataset with noise drawn anew.
fn redraw(synthetic: &Synthetic, seed: u64) -> Dataset {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, SIGMA_PX).unwrap();
    let mut dataset = synthetic.dataset.clone();
    for (view, clean) in dataset.views.iter_mut().zip(&synthetic.clean_px) {
        for (observation, clean) in view.observations.iter_mut().zip(clean) {
            observation.pixel = clean.map(|pixel| pixel + noise.sample(&mut rng));
            observation.sigma_px = 1.0;
        }
    }
    dataset
}

/// Returns the parameters that the covariance is of, in its order; rotations as left perturbations of the truth's.
///
/// The first `n_held` parameters of a lens are held.
fn parameters(calibration: &Calibration, truth: &Scene, n_held: usize) -> Vec<f64> {
    let mut parameters = Vec::new();
    for (i, (camera, truth)) in calibration.scene.rig.cameras.iter().zip(&truth.rig.cameras).enumerate() {
        let (camera, truth) = (camera.as_ref().unwrap(), truth.as_ref().unwrap());
        parameters.extend(&camera.camera.params[n_held..]);
        if i > 0 {
            parameters.extend((camera.cam_from_rig * truth.cam_from_rig.inverse()).log().iter());
        }
    }
    parameters.extend(calibration.scene.targets.iter().flat_map(|target| &target.shape_m));
    parameters
}

/// Returns where the mean of all frames takes a point of the truth's rig, in the rig of the draw.
fn carried_by_frames(truth: &Scene, drawn: &Scene, point_in_rig: Vector3<f64>) -> Vector3<f64> {
    let both = truth.rig_from_target.iter().zip(&drawn.rig_from_target);
    let carried: Vec<Vector3<f64>> =
        both.filter_map(|(truth, drawn)| Some((*drawn)? * ((*truth)?.inverse() * point_in_rig))).collect();
    carried.iter().sum::<Vector3<f64>>() / carried.len() as f64
}

/// Returns the motion in the camera's frame after which the truth's lens sees the draw's corners best
/// where they truly are.
fn motion_of_views(synthetic: &Synthetic, drawn: &Scene, camera: CameraId) -> Pose {
    let truth = synthetic.truth.rig.cameras[camera].as_ref().unwrap();
    let placed = drawn.rig.cameras[camera].as_ref().unwrap();
    let mut corners: Vec<(Vector3<f64>, [f64; 2])> = Vec::new();
    for (view, clean) in synthetic.dataset.views.iter().zip(&synthetic.clean_px) {
        if view.camera != camera {
            continue;
        }
        let Some(rig_from_target) = drawn.rig_from_target[view.frame] else { continue };
        let target = &synthetic.dataset.targets[view.target];
        let shape_m = &drawn.targets[view.target].shape_m;
        for (observation, clean) in view.observations.iter().zip(clean) {
            let point = target.point(observation.point, shape_m);
            corners.push((placed.cam_from_rig * (rig_from_target * point), *clean));
        }
    }
    let mut motion = Pose::identity();
    for _ in 0..2 {
        let mut normal = boresight_geometry::Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for (point, clean) in &corners {
            let pixel = truth.camera.project(&(motion * *point)).unwrap();
            let mut by_motion = [Vector6::zeros(), Vector6::zeros()];
            let step = 1e-6;
            for k in 0..6 {
                let mut tangent = Vector6::zeros();
                tangent[k] = step;
                let moved = truth.camera.project(&(motion.perturbed(&tangent) * *point)).unwrap();
                (0..2).for_each(|row| by_motion[row][k] = (moved[row] - pixel[row]) / step);
            }
            for row in 0..2 {
                normal += by_motion[row] * by_motion[row].transpose();
                gradient += by_motion[row] * (pixel[row] - clean[row]);
            }
        }
        motion = motion.perturbed(&-normal.cholesky().unwrap().solve(&gradient));
    }
    motion
}

/// Returns where a draw projects what the truth sees at a pixel, by either method.
fn projected(
    synthetic: &Synthetic,
    drawn: &Scene,
    camera: CameraId,
    pixels: &[[f64; 2]],
) -> [Vec<[f64; 2]>; 2] {
    let truth = synthetic.truth.rig.cameras[camera].as_ref().unwrap();
    let placed = drawn.rig.cameras[camera].as_ref().unwrap();
    let truth_from_drawn = motion_of_views(synthetic, drawn, camera);
    let seen = |camera: &Camera, point: Vector3<f64>| camera.project(&point).unwrap();
    let points: Vec<Vector3<f64>> =
        pixels.iter().map(|&pixel| truth.camera.unproject(pixel).unwrap() * DISTANCE_M).collect();
    let by_mean = points.iter().map(|point| {
        let carried = carried_by_frames(&synthetic.truth, drawn, truth.cam_from_rig.inverse() * *point);
        seen(&placed.camera, placed.cam_from_rig * carried)
    });
    let by_views = points.iter().map(|point| seen(&placed.camera, truth_from_drawn.inverse() * *point));
    [by_mean.collect(), by_views.collect()]
}

/// What was found: ratios of stated sigma to scatter.
struct Ratios {
    parameters: Vec<f64>,
    /// Of the worst direction over the image, by method.
    maps: [Vec<f64>; 2],
}

fn measure(recipe: Recipe, draws: u64, n_held: usize) -> Ratios {
    let synthetic = simulate(&Recipe { sigma_px: SIGMA_PX, ..recipe }, 7);
    let held = synthetic.truth.rig.cameras.ids();
    let held = held.flat_map(|camera| (0..n_held).map(move |param| Hold::LensParam(camera, param)));
    let options = AdjustOptions {
        rejection: Rejection::None,
        holds: held.collect(),
        // One in some hundred searches over splines takes more steps than are usual.
        max_iterations: 2000,
        ..AdjustOptions::default()
    };
    let cameras: Vec<CameraId> = synthetic.truth.rig.cameras.ids().collect();
    let methods = [Method::MeanFrame, Method::CrossReprojection];
    let pixels = |camera: CameraId| -> Vec<[f64; 2]> {
        let size = synthetic.truth.rig.cameras[camera].as_ref().unwrap().camera.image_size;
        // The borders' corners are left out, where few or no corners of boards are.
        let along = |i: usize, n: usize, size: u32| f64::from(size) * (0.1 + 0.8 * i as f64 / (n - 1) as f64);
        (0..GRID[0] * GRID[1])
            .map(|i| [along(i % GRID[0], GRID[0], size[0]), along(i / GRID[0], GRID[1], size[1])])
            .collect()
    };
    let mut stated: Vec<f64> = Vec::new();
    let mut samples: Vec<Vec<f64>> = Vec::new();
    // By method, camera and pixel: the stated worst variances, and what was projected.
    let mut stated_px2 = vec![0.0; 2 * cameras.len() * GRID[0] * GRID[1]];
    let mut projections: Vec<Vec<[f64; 2]>> = vec![Vec::new(); stated_px2.len()];
    let (begin, mut n_evaluations) = (Instant::now(), 0);
    for draw in 0..draws {
        let calibration = adjust(&redraw(&synthetic, draw), &synthetic.truth, &options, None).unwrap();
        let solve = &calibration.solve;
        n_evaluations += solve.evaluations;
        let unavailable = &calibration.uncertainty.unavailable;
        assert!(solve.converged && unavailable.is_none(), "draw {draw}: {solve:?} {unavailable:?}");
        let n = calibration.uncertainty.names.len();
        stated.resize(n, 0.0);
        for (i, sum) in stated.iter_mut().enumerate() {
            *sum += calibration.uncertainty.covariance[i * (n + 1)] / draws as f64;
        }
        samples.push(parameters(&calibration, &synthetic.truth, n_held));
        for (place, &camera) in cameras.iter().enumerate() {
            let pixels = pixels(camera);
            let found = projected(&synthetic, &calibration.scene, camera, &pixels);
            for (which, method) in methods.into_iter().enumerate() {
                let known =
                    ProjectionUncertainty::new(&calibration, camera, method, Propagation::WithBeliefs)
                        .unwrap();
                for (i, &pixel) in pixels.iter().enumerate() {
                    let entry = (which * cameras.len() + place) * pixels.len() + i;
                    projections[entry].push(found[which][i]);
                    stated_px2[entry] +=
                        known.at(pixel, Some(DISTANCE_M)).unwrap().worst_px().powi(2) / draws as f64;
                }
            }
        }
    }
    let n_draws = draws as f64;
    println!(
        "{draws} draws: each {:.1} ms, {:.1} evaluations",
        1e3 * begin.elapsed().as_secs_f64() / n_draws,
        n_evaluations as f64 / n_draws
    );
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / n_draws;
    assert_eq!(samples[0].len(), stated.len());
    // Knots are believed to be zero with a sigma of one, in units of the noise as all sigmas are.
    let is_measured = |i: &usize| n_held == 0 || stated[*i].sqrt() < BELIEVED_SHARE * SIGMA_PX;
    let parameters = (0..stated.len()).filter(is_measured).map(|i| {
        let middle = mean(&mut samples.iter().map(|sample| sample[i]));
        let scatter = mean(&mut samples.iter().map(|sample| (sample[i] - middle).powi(2)));
        (stated[i] / scatter).sqrt()
    });
    let ratio = |(stated, found): (&f64, &Vec<[f64; 2]>)| {
        let [u, v] = [0, 1].map(|axis| mean(&mut found.iter().map(|pixel| pixel[axis])));
        let product = |a: usize, b: usize| {
            let middle = [u, v];
            mean(&mut found.iter().map(|pixel| (pixel[a] - middle[a]) * (pixel[b] - middle[b])))
        };
        let (uu, uv, vv) = (product(0, 0), product(0, 1), product(1, 1));
        let worst = 0.5 * (uu + vv) + (0.5 * (uu - vv)).hypot(uv);
        (stated / worst).sqrt()
    };
    let by_method = stated_px2.len() / 2;
    let maps: Vec<f64> = stated_px2.iter().zip(&projections).map(ratio).collect();
    Ratios {
        parameters: parameters.collect(),
        maps: [maps[..by_method].to_vec(), maps[by_method..].to_vec()],
    }
}

/// Prints mean and extremes, and returns them.
fn summary(what: &str, ratios: &[f64]) -> [f64; 3] {
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    let most = ratios.iter().copied().fold(0.0, f64::max);
    println!(
        "{what}: stated over scatter {mean:.3} on average, {least:.3} to {most:.3}, of {}",
        ratios.len()
    );
    [mean, least, most]
}

/// Checks means against 5 %, and single ratios against 5 % and three of the scatter's own sigmas.
fn check(name: &str, recipe: Recipe, draws: u64) {
    check_with_held(name, recipe, draws, 0);
}

fn check_with_held(name: &str, recipe: Recipe, draws: u64, n_held: usize) {
    let ratios = measure(recipe, draws, n_held);
    // A standard deviation from n draws is known to 1/sqrt(2 n) of itself.
    let own = 3.0 / (2.0 * draws as f64).sqrt();
    let [mean, least, most] = summary(&format!("{name}, sigmas"), &ratios.parameters);
    assert!((mean - 1.0).abs() < 0.05 && least > 0.95 - own && most < 1.05 + own);
    for (method, map) in ["mean frame", "cross-reprojection"].iter().zip(&ratios.maps) {
        let [mean, least, most] = summary(&format!("{name}, projections, {method}"), map);
        assert!((mean - 1.0).abs() < 0.10 && least > 0.9 - own && most < 1.1 + own);
    }
}

#[test]
fn a_cameras_uncertainty_is_its_scatter() {
    check("mono", Recipe::mono(), 100);
}

/// Returns one camera whose lens is a spline, in front of as many frames as tell its knots. From 40 frames, 12x10 knots are
/// known so badly at the border that what they do is far from linear, and everything scatters 2.5 times what is stated.
fn splined() -> Recipe {
    let mut recipe = Recipe::mono();
    let model = "splined3:8x6:76deg".parse().unwrap();
    recipe.cameras[0].camera =
        convert(&recipe.cameras[0].camera, model, ImpliedRotation::None).unwrap().camera;
    recipe.frames = 200;
    recipe.placement.image_share = 0.85;
    recipe
}

// Heavy: `cargo test --release -p boresight-tests --test golden scatter -- --ignored --nocapture`. From 5000 draws a
// scatter is known to 1 %, from 500 to 3.2 %.

#[test]
#[ignore = "5000 solves; run in release"]
fn a_cameras_uncertainty_is_the_scatter_of_5000_draws() {
    check("mono", Recipe::mono(), 5000);
}

#[test]
#[ignore = "5000 solves; run in release"]
fn a_pairs_uncertainty_is_the_scatter_of_5000_draws() {
    check("stereo", Recipe::stereo(), 5000);
}

#[test]
#[ignore = "5000 solves; run in release"]
fn the_uncertainty_of_four_cameras_is_the_scatter_of_5000_draws() {
    check("four cameras", Recipe::ring(4), 5000);
}

#[test]
#[ignore = "500 solves; run in release"]
fn a_splines_uncertainty_is_the_scatter_of_500_draws() {
    // The core of a spline trades against its knots, so it is held.
    check_with_held("splined", splined(), 500, 4);
}
