//! From a recipe to a truth and the dataset that cameras would have made of it.

use boresight_data::{
    CameraId, CameraInfo, Dataset, Frame, FrameId, Id as _, Observation, PointId, Rig, RigCamera, Scene,
    TargetBelief, TargetId, View,
};
use boresight_geometry::Pose;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::Recipe;
use crate::place::{centre_of, draw_pose, visible_points};

/// Poses drawn for a frame before it is left without a view.
const ATTEMPTS: usize = 200;

/// A truth and what was seen of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Synthetic {
    /// What the cameras looked at.
    pub truth: Scene,
    /// What they saw, with noise and outliers.
    pub dataset: Dataset,
    /// Where each observation of each view would be without either.
    pub clean_px: Vec<Vec<[f64; 2]>>,
    /// The outliers, as index of the view and point, in the order of the views.
    pub outliers: Vec<(usize, PointId)>,
}

/// Simulates a recipe. A frame in which no camera can see enough of the target has neither view nor pose.
pub fn simulate(recipe: &Recipe, seed: u64) -> Synthetic {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut made = Synthetic {
        truth: truth_without_frames(recipe),
        dataset: dataset_without_views(recipe),
        clean_px: Vec::new(),
        outliers: Vec::new(),
    };
    for frame in (0..recipe.frames).map(FrameId::from_index) {
        let placed = place_frame(&mut rng, recipe, frame.index());
        made.truth.rig_from_target.push(placed.as_ref().map(|(pose, _)| *pose));
        for (camera, seen) in placed.into_iter().flat_map(|(_, views)| views) {
            observe(&mut rng, recipe, &mut made, camera, frame, seen);
        }
    }
    made
}

/// The points that a camera sees, with their clean pixels.
type Seen = (CameraId, Vec<(PointId, [f64; 2])>);

/// Draws a pose of the target until some camera sees enough of it.
fn place_frame(rng: &mut ChaCha8Rng, recipe: &Recipe, frame_idx: usize) -> Option<(Pose, Vec<Seen>)> {
    let centre_in_target = centre_of(&recipe.target);
    for _ in 0..ATTEMPTS {
        let shown_to = recipe.cameras.get(frame_idx % recipe.cameras.len().max(1))?;
        let drawn = draw_pose(rng, &shown_to.camera, &recipe.placement, &centre_in_target);
        let Some(cam_from_target) = drawn else { continue };
        let rig_from_target = shown_to.cam_from_rig.inverse() * cam_from_target;
        let see = |(i, placed): (usize, &crate::PlacedCamera)| {
            let cam_from_target = placed.cam_from_rig * rig_from_target;
            let seen = visible_points(&placed.camera, &cam_from_target, &recipe.target, &recipe.shape_m);
            (CameraId::from_index(i), seen)
        };
        let seen = recipe.cameras.iter().enumerate().map(see);
        let views: Vec<Seen> = seen.filter(|(_, seen)| seen.len() >= recipe.min_points.max(1)).collect();
        if !views.is_empty() {
            return Some((rig_from_target, views));
        }
    }
    None
}

/// Adds a view: drops what stays hidden, and puts noise and gross errors on the rest.
pub(crate) fn observe(
    rng: &mut ChaCha8Rng,
    recipe: &Recipe,
    made: &mut Synthetic,
    camera: CameraId,
    frame: FrameId,
    seen: Vec<(PointId, [f64; 2])>,
) {
    let view_idx = made.dataset.views.len();
    let (mut observations, mut clean, mut outliers) = (Vec::new(), Vec::new(), Vec::new());
    for (point, pixel) in seen {
        // Every point draws the same numbers, so that changing one share leaves all else as it was.
        let [hidden, gross]: [f64; 2] = rng.random();
        let noise: [f64; 4] = std::array::from_fn(|_| rng.sample(StandardNormal));
        if hidden < recipe.hidden_share {
            continue;
        }
        let mut noisy = [0, 1].map(|axis| pixel[axis] + recipe.sigma_px * noise[axis]);
        if gross < recipe.outliers.share {
            noisy = [0, 1].map(|axis| noisy[axis] + recipe.outliers.sigma_px * noise[2 + axis]);
            outliers.push((view_idx, point));
        }
        let sigma_px = if recipe.sigma_px > 0.0 { recipe.sigma_px } else { 1.0 };
        observations.push(Observation { point, pixel: noisy, sigma_px });
        clean.push(pixel);
    }
    if observations.len() >= recipe.min_points {
        made.dataset.views.push(View { camera, frame, target: TargetId(0), image: None, observations });
        made.clean_px.push(clean);
        made.outliers.extend(outliers);
    }
}

pub(crate) fn truth_without_frames(recipe: &Recipe) -> Scene {
    let cameras =
        recipe.cameras.iter().map(|placed| Some(RigCamera::new(placed.camera.clone(), placed.cam_from_rig)));
    let belief = TargetBelief { shape_m: recipe.shape_m.clone(), first_from_target: Pose::identity() };
    Scene { rig: Rig { cameras: cameras.collect() }, targets: vec![belief].into(), ..Scene::default() }
}

pub(crate) fn dataset_without_views(recipe: &Recipe) -> Dataset {
    let camera = |placed: &crate::PlacedCamera| CameraInfo {
        name: placed.name.clone(),
        image_size: placed.camera.image_size,
    };
    Dataset {
        cameras: recipe.cameras.iter().map(camera).collect(),
        targets: vec![recipe.target.clone()].into(),
        frames: (0..recipe.frames)
            .map(|i| Frame { name: format!("frame{i:03}"), ..Frame::default() })
            .collect(),
        views: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Outliers;

    /// Checks that the truth explains the clean pixels, and returns the RMS of the noise (both coordinates).
    fn check(recipe: &Recipe, seed: u64) -> f64 {
        let made = simulate(recipe, seed);
        assert_eq!(made, simulate(recipe, seed));
        assert_ne!(made.dataset.views, simulate(recipe, seed + 1).dataset.views);
        assert!(made.dataset.views.is_sorted_by_key(|view| (view.frame, view.camera)));
        let (mut square, mut count) = (0.0, 0);
        for (view, clean) in made.dataset.views.iter().zip(&made.clean_px) {
            let placed = made.truth.rig.cameras[view.camera].as_ref().unwrap();
            let cam_from_target = placed.cam_from_rig * made.truth.rig_from_target[view.frame].unwrap();
            assert!(view.observations.is_sorted_by_key(|observation| observation.point));
            for (observation, clean) in view.observations.iter().zip(clean) {
                let point = made.dataset.targets[view.target].point(observation.point, &recipe.shape_m);
                assert_eq!(placed.camera.project(&(cam_from_target * point)), Some(*clean));
                square += (0..2).map(|axis| (observation.pixel[axis] - clean[axis]).powi(2)).sum::<f64>();
                count += 1;
            }
        }
        (square / f64::from(count)).sqrt()
    }

    #[test]
    fn all_recipes_keep_their_word() {
        for recipe in [Recipe::mono(), Recipe::fisheye(), Recipe::stereo(), Recipe::ring(4), Recipe::ring(8)]
        {
            // Over a thousand draws the RMS is within a few percent of sigma times the root of two.
            let rms = check(&recipe, 1) / (recipe.sigma_px * 2f64.sqrt());
            assert!((rms - 1.0).abs() < 0.06, "{rms}");
            let views = simulate(&recipe, 2).dataset.views;
            for camera in 0..recipe.cameras.len() {
                let n_views = views.iter().filter(|view| view.camera.index() == camera).count();
                assert!(n_views >= 10, "camera {camera} has {n_views} views");
            }
        }
    }

    #[test]
    fn the_ring_is_connected() {
        let views = simulate(&Recipe::ring(8), 5).dataset.views;
        for neighbour in 1..8 {
            let frames = |camera: usize| {
                views.iter().filter(move |view| view.camera.index() == camera).map(|view| view.frame)
            };
            let shared = frames(neighbour).filter(|&frame| frames(neighbour - 1).any(|f| f == frame)).count();
            assert!(shared >= 5, "cameras {} and {neighbour} share {shared} frames", neighbour - 1);
        }
    }

    #[test]
    fn outliers_and_hidden_points_come_as_ordered() {
        let plain = Recipe::mono();
        let spoilt =
            Recipe { outliers: Outliers { share: 0.05, sigma_px: 30.0 }, hidden_share: 0.2, ..plain.clone() };
        let (clean, made) = (simulate(&plain, 3), simulate(&spoilt, 3));
        let kept = made.dataset.observation_count() as f64 / clean.dataset.observation_count() as f64;
        assert!((kept - 0.8).abs() < 0.05, "{kept}");
        let share = made.outliers.len() as f64 / made.dataset.observation_count() as f64;
        assert!((share - 0.05).abs() < 0.02, "{share}");
        assert_eq!(clean.truth, made.truth);
    }

    #[test]
    fn an_impossible_recipe_has_frames_without_views() {
        let mut recipe = Recipe::mono();
        recipe.min_points = 1000;
        let made = simulate(&recipe, 0);
        assert_eq!((made.dataset.views.len(), made.truth.rig_from_target[FrameId(0)]), (0, None));
    }
}
