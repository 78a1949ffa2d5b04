//! A small stereo recording with known truth, to try the program on, and what a calibration made of it.

use boresight_data::{Calibration, Geometry, Id as _, Scene, Shape};
use boresight_geometry::nalgebra::{DMatrix, DVector};
use boresight_geometry::{Matrix3, Pose, Vector3, left_jacobian_inverse};
use boresight_io::{OutputFile, export, gray_to_png, target_spec};
use boresight_synthetic::{Exposure, PlacedCamera, Recipe, render, simulate};
use rayon::prelude::*;

use crate::error::Error;

/// How many pairs of images there are.
const FRAMES: usize = 20;
const IMAGE_SIZE: [u32; 2] = [640, 480];
/// The real board is bent by so much, in metres.
const BEND_M: [f64; 2] = [0.0004, -0.0006];

/// A recording and its truth.
#[derive(Clone, Debug)]
pub struct Demo {
    /// The target, as the command line takes it.
    pub target: String,
    /// The images of two cameras, `left-00.png` and so on.
    pub images: Vec<OutputFile>,
    /// The true cameras, as mrcal's files.
    pub truth_files: Vec<OutputFile>,
    /// The truth.
    pub truth: Scene,
}

/// A number that was estimated, and its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovered {
    /// What it is, such as `left.fx` or `right.x`.
    pub name: String,
    /// The unit of the following, or nothing.
    pub unit: &'static str,
    /// The truth.
    pub truth: f64,
    /// The estimate.
    pub estimate: f64,
    /// The standard deviation of the estimate, as the calibration states it.
    pub sigma: f64,
}

/// How near a calibration comes to the truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovery {
    /// Every number that the calibration has a covariance of: lenses, places and orientations of cameras in the rig,
    /// and how far targets are bent.
    pub numbers: Vec<Recovered>,
    /// The squared distance from the truth in units of the joint covariance; as many as there are numbers are expected.
    pub chi2: f64,
}

impl Recovery {
    /// Tells whether the distance is one that noise explains: within four standard deviations of what is expected.
    pub fn is_explained(&self) -> bool {
        let n = self.numbers.len() as f64;
        self.chi2 <= n + 4.0 * (2.0 * n).sqrt()
    }
}

/// Renders a chessboard as two cameras 0.2 m apart see it, with distortion, blur, vignetting and noise.
///
/// The same seed gives the same bytes.
pub fn demo(seed: u64) -> Result<Demo, Error> {
    let mut recipe = Recipe { frames: FRAMES, shape_m: BEND_M.to_vec(), ..Recipe::stereo() };
    recipe.target.geometry = Geometry::Chessboard { columns: 9, rows: 6, spacing_m: 0.04 };
    recipe.target.shape = Shape::Parabolic2;
    recipe.placement.image_share = 0.8;
    recipe.placement.distance_m = [0.4, 0.8];
    for (placed, name) in recipe.cameras.iter_mut().zip(["left", "right"]) {
        *placed = PlacedCamera { name: name.to_owned(), ..placed.scaled_to(IMAGE_SIZE) };
    }
    let truth = simulate(&recipe, seed).truth;
    let shots: Vec<(usize, usize, Pose)> = truth
        .rig_from_target
        .enumerate()
        .filter_map(|(frame, pose)| Some((frame.index(), (*pose)?)))
        .flat_map(|(frame, pose)| (0..recipe.cameras.len()).map(move |camera| (frame, camera, pose)))
        .collect();
    let image =
        |&(frame, camera, rig_from_target): &(usize, usize, Pose)| -> Option<Result<OutputFile, Error>> {
            let placed = &recipe.cameras[camera];
            let seed = seed.wrapping_mul(1000).wrapping_add((2 * frame + camera) as u64);
            let (cam_from_target, exposure) = (placed.cam_from_rig * rig_from_target, Exposure::default());
            let image =
                render(&placed.camera, &cam_from_target, &recipe.target, &recipe.shape_m, &exposure, seed)?;
            let name = format!("{}-{frame:02}.png", placed.name);
            Some(gray_to_png(&image).map(|bytes| OutputFile { name, bytes }).map_err(Error::from))
        };
    let images: Vec<OutputFile> = shots.par_iter().filter_map(image).collect::<Result<_, _>>()?;
    let names = recipe.cameras.iter().map(|placed| placed.name.clone());
    let true_rig = Scene { rig: truth.rig.clone(), ..Scene::default() };
    let truth_files = export(&Calibration::unsolved(true_rig, names, "this is the truth"), "cameramodel")?;
    let target = target_spec(&recipe.target).unwrap_or_default();
    Ok(Demo { target, images, truth_files, truth })
}

/// Returns how near a calibration comes to a truth whose cameras and targets are in the same order; `None` if it has no
/// covariance, or estimated something that the truth does not have.
pub fn recovery(calibration: &Calibration, truth: &Scene) -> Option<Recovery> {
    let names = &calibration.uncertainty.names;
    let n = names.len();
    let mut covariance = DMatrix::from_row_slice(n, n, calibration.uncertainty.covariance.get(..n * n)?);
    let at = |name: &str| names.iter().position(|known| known == name);
    let mut numbers = Vec::new();
    let unknown = Recovered { name: String::new(), unit: "", truth: 0.0, estimate: 0.0, sigma: 0.0 };
    numbers.resize(n, unknown);
    // How what is shown changes with what the covariance is of.
    let mut shown_from_estimated = DMatrix::identity(n, n);
    for ((fit, estimated), true_one) in
        calibration.cameras.iter().zip(&calibration.scene.rig.cameras).zip(&truth.rig.cameras)
    {
        let (Some(estimated), Some(true_one)) = (estimated, true_one) else { continue };
        let of_lens = true_one.camera.params.iter().zip(&estimated.camera.params);
        for (param, (truth, estimate)) in estimated.camera.model.param_names().iter().zip(of_lens) {
            let Some(i) = at(&format!("{}.{param}", fit.name)) else { continue };
            let unit = if ["fx", "fy", "cx", "cy"].contains(param) { "px" } else { "" };
            let (truth, estimate) = (*truth, *estimate);
            numbers[i] = Recovered { name: names[i].clone(), unit, truth, estimate, sigma: 0.0 };
        }
        let Some(first) = at(&format!("{}.cam_from_rig.rx_rad", fit.name)) else { continue };
        let [truth, estimate] = [true_one, estimated].map(|one| one.cam_from_rig.inverse());
        let [turn, shift] = shown_from_perturbation(&estimate);
        for k in 0..3 {
            let axis = ["x", "y", "z"][k];
            let degrees = |rotation: Vector3<f64>| rotation[k].to_degrees();
            numbers[first + k] = Recovered {
                name: format!("{}.r{axis}", fit.name),
                unit: "deg",
                truth: degrees(truth.rotation.scaled_axis()),
                estimate: degrees(estimate.rotation.scaled_axis()),
                sigma: 0.0,
            };
            numbers[first + 3 + k] = Recovered {
                name: format!("{}.{axis}", fit.name),
                unit: "mm",
                truth: 1e3 * truth.translation[k],
                estimate: 1e3 * estimate.translation[k],
                sigma: 0.0,
            };
            for j in 0..3 {
                shown_from_estimated[(first + k, first + j)] = turn[(k, j)].to_degrees();
                shown_from_estimated[(first + 3 + k, first + 3 + j)] = 1e3 * shift[(k, j)];
            }
        }
    }
    let beliefs = calibration.scene.targets.iter().zip(&truth.targets);
    for (target, (estimated, true_one)) in calibration.targets.iter().zip(beliefs) {
        for (j, (truth, estimate)) in true_one.shape_m.iter().zip(&estimated.shape_m).enumerate() {
            let Some(i) = at(&format!("{}.shape{j}_m", target.name)) else { continue };
            let name = format!("{}.bend {}", target.name, ["x", "y"].get(j)?);
            numbers[i] =
                Recovered { name, unit: "mm", truth: 1e3 * truth, estimate: 1e3 * estimate, sigma: 0.0 };
            shown_from_estimated[(i, i)] = 1e3;
        }
    }
    if numbers.iter().any(|number| number.name.is_empty()) {
        return None;
    }
    covariance = &shown_from_estimated * covariance * shown_from_estimated.transpose();
    for (i, number) in numbers.iter_mut().enumerate() {
        number.sigma = covariance[(i, i)].sqrt();
    }
    let off = DVector::from_iterator(
        n,
        numbers.iter().map(|number| (number.estimate - number.truth) / number.sigma),
    );
    // In units of each sigma, so that numbers of all sizes go together.
    let correlation =
        DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (numbers[i].sigma * numbers[j].sigma));
    let chi2 = off.dot(&correlation.cholesky()?.solve(&off));
    Some(Recovery { numbers, chi2 })
}

/// Returns how the orientation (Rodrigues vector) of a camera in its rig changes with r, and its place with t, where
/// `cam_from_rig` is perturbed by exp([r t]).
fn shown_from_perturbation(rig_from_cam: &Pose) -> [Matrix3<f64>; 2] {
    // The rotation R of rig_from_cam becomes R exp(-r), and its translation C - R t.
    let turn = -left_jacobian_inverse(&-rig_from_cam.rotation.scaled_axis());
    [turn, -rig_from_cam.rotation.to_rotation_matrix().into_inner()]
}

#[cfg(test)]
mod tests {
    use boresight_data::Uncertainty;
    use boresight_geometry::Vector6;
    use boresight_io::{Job, image_from_bytes};

    use super::*;
    use crate::{CalibrateOptions, HoldoutChoice, Watch, calibrate};

    /// Returns what a simulated recipe is calibrated to, and its truth.
    fn simulated(seed: u64) -> (Calibration, Scene) {
        let made = simulate(&Recipe { frames: 12, ..Recipe::stereo() }, seed);
        let options = CalibrateOptions { holdout: HoldoutChoice::Off, ..CalibrateOptions::default() };
        (calibrate(&Job::from(made.dataset), &options, &Watch::default()).unwrap().calibration, made.truth)
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes() {
        let [one, again, other] = [3, 3, 4].map(|seed| demo(seed).unwrap());
        assert_eq!((&one.images, &one.truth_files), (&again.images, &again.truth_files));
        assert_eq!(one.images.len(), 2 * FRAMES);
        assert!(one.images.iter().zip(&other.images).all(|(one, other)| one.bytes != other.bytes));
        let read = image_from_bytes("left-00.png", &one.images[0].bytes).unwrap();
        assert_eq!(read.image.size(), IMAGE_SIZE);
        assert_eq!(one.target, "chessboard:9x6:40mm");
    }

    #[test]
    fn the_distance_from_the_truth_is_what_the_covariance_says() {
        let distances: Vec<f64> = (0..12)
            .map(|seed| {
                let (calibration, truth) = simulated(seed);
                let found = recovery(&calibration, &truth).unwrap();
                assert!(found.is_explained(), "{found:?}");
                assert_eq!(found.numbers.len(), 26);
                found.chi2 / 26.0
            })
            .collect();
        // The mean of 12 has a sigma of sqrt(2 / (26 * 12)) = 0.08.
        let mean = distances.iter().sum::<f64>() / 12.0;
        assert!((mean - 1.0).abs() < 0.3, "{mean}: {distances:?}");
    }

    #[test]
    fn a_wrong_estimate_is_not_explained() {
        let (mut calibration, truth) = simulated(1);
        let found = recovery(&calibration, &truth).unwrap();
        let tx = found.numbers.iter().find(|number| number.name == "cam1.x").unwrap();
        assert!((tx.truth - 200.0).abs() < 5.0 && tx.unit == "mm", "{tx:?}");
        let shift_m = 2e-2 * tx.sigma;
        for camera in calibration.scene.rig.cameras.iter_mut().flatten().skip(1) {
            camera.cam_from_rig.translation.x += shift_m;
        }
        assert!(!recovery(&calibration, &truth).unwrap().is_explained());
        calibration.uncertainty = Uncertainty::default();
        // Nothing was estimated, so there is nothing that could be wrong.
        assert_eq!(recovery(&calibration, &truth).unwrap().numbers, Vec::new());
    }

    #[test]
    fn what_is_shown_of_a_pose_follows_its_perturbation() {
        let cam_from_rig = Pose::from_rodrigues(Vector3::new(0.4, -1.1, 0.6), Vector3::new(0.3, -0.2, 1.4));
        let rig_from_cam = cam_from_rig.inverse();
        let [turn, shift] = shown_from_perturbation(&rig_from_cam);
        let step = 1e-6;
        for k in 0..3 {
            let moved = |axis: usize| {
                let mut tangent = Vector6::zeros();
                tangent[axis] = step;
                let [up, down] =
                    [tangent, -tangent].map(|tangent| (Pose::exp(&tangent) * cam_from_rig).inverse());
                [
                    (up.rotation.scaled_axis() - down.rotation.scaled_axis()) / (2.0 * step),
                    (up.translation - down.translation) / (2.0 * step),
                ]
            };
            let ([by_turn, _], [_, by_shift]) = (moved(k), moved(3 + k));
            assert!((by_turn - turn.column(k)).norm() < 1e-8, "{k}");
            assert!((by_shift - shift.column(k)).norm() < 1e-8, "{k}");
            // A turn about the camera's centre leaves it where it is.
            assert!(moved(k)[1].norm() < 1e-8);
        }
    }
}
