//! Which lens model a camera has: by the error on views that took no part, with as few parameters as do.

use std::collections::BTreeSet;

use boresight_camera::Model;
use boresight_data::{CameraId, Dataset, PointId};
use rayon::prelude::*;

use crate::calibrate::is_noncentral;
use crate::select::as_one_camera;
use crate::trial::{Fit, Terms, Trial, ViewErrors, comparable_rms_px, excess, without};

/// A model that leaves out a larger share of the views than another is not compared with it.
const LEFT_OUT_SHARE: f64 = 0.1;

/// What is not tried: map projections are no lenses.
const NOT_TRIED: [&str; 2] = ["lonlat", "latlon"];

/// What a lens model made of a camera's views.
#[derive(Clone, Debug)]
pub struct ModelTrial {
    /// The model.
    pub model: Model,
    /// The root of the mean squared distance of corners in views that took no part in fitting the lens,
    /// in pixels.
    pub held_out_px: f64,
    /// How far these residuals point the same way in parts of the image, in pixels: zero of a model that fits.
    pub bias_px: f64,
    /// Why the model is out of the question, where it is.
    pub problem: Option<String>,
    views: ViewErrors,
}

/// The model chosen for a camera, and why.
#[derive(Clone, Debug)]
pub struct LensSelection {
    /// The camera's name; those of cameras that share a lens as in `left+right`.
    pub camera: String,
    /// The model chosen.
    pub model: Model,
    /// Every model tried, in the order of the registry.
    pub trials: Vec<ModelTrial>,
    /// Why this one, and what the next would cost, in a sentence.
    pub why: String,
}

/// No lens model explains what a camera saw.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("no lens model fits camera {camera}: {}", problems.join("; "))]
pub struct NoLens {
    /// The camera's name.
    pub camera: String,
    /// What is wrong with each model.
    pub problems: Vec<String>,
}

/// Chooses a lens model for a camera of `dataset` by its own views, or for cameras that share a lens by theirs.
pub(crate) fn choose_lens(
    dataset: &Dataset,
    cameras: &[CameraId],
    terms: Terms<'_>,
) -> Result<LensSelection, NoLens> {
    let names: Vec<&str> = cameras.iter().map(|camera| dataset.cameras[*camera].name.as_str()).collect();
    select(&names.join("+"), trials(&as_one_camera(dataset, cameras), &names, terms))
}

/// Tries every model of the registry that has few enough parameters to be compared.
fn trials(dataset: &Dataset, cameras: &[&str], terms: Terms<'_>) -> Vec<ModelTrial> {
    let models = Model::names().into_iter().filter(|name| !NOT_TRIED.contains(name));
    let models = models.filter_map(|name| name.parse::<Model>().ok());
    let models: Vec<Model> =
        models.filter(|model| model.local_support().is_none() && !is_noncentral(*model)).collect();
    let fits: Vec<Result<Fit, String>> =
        models.par_iter().map(|model| Fit::new(dataset, cameras, *model, None, terms)).collect();
    // What every model rejects is wrong; what some reject may be what they cannot explain.
    let mut outliers: Option<BTreeSet<(usize, PointId)>> = None;
    for fit in fits.iter().flatten() {
        outliers = Some(outliers.map_or(fit.outliers.clone(), |all| &all & &fit.outliers));
    }
    let clean = without(dataset, &outliers.unwrap_or_default());
    let trial = |(model, fit): (&Model, &Result<Fit, String>)| {
        let trial = fit.as_ref().map_err(Clone::clone).and_then(|fit| Trial::new(&clean, fit));
        match trial {
            Ok(Trial { held_out_px, bias_px, views }) => {
                let problem = fit.as_ref().ok().and_then(|fit| fit.problem.clone());
                ModelTrial { model: *model, held_out_px, bias_px, problem, views }
            }
            Err(why) => ModelTrial {
                model: *model,
                held_out_px: f64::INFINITY,
                bias_px: f64::INFINITY,
                problem: Some(why),
                views: Vec::new(),
            },
        }
    };
    models.par_iter().zip(&fits).map(trial).collect()
}

/// Selects the model of fewest parameters that predicts as well as the best one does.
fn select(camera: &str, trials: Vec<ModelTrial>) -> Result<LensSelection, NoLens> {
    let most = trials.iter().map(|trial| trial.views.iter().flatten().count()).max().unwrap_or(0);
    let is_complete = |trial: &ModelTrial| {
        let n = trial.views.iter().flatten().count();
        n > 0 && n as f64 >= (1.0 - LEFT_OUT_SHARE) * most as f64
    };
    let usable: Vec<usize> =
        (0..trials.len()).filter(|&idx| trials[idx].problem.is_none() && is_complete(&trials[idx])).collect();
    let Some(chosen) = simplest(&trials, &usable) else {
        let problem = |trial: &ModelTrial| {
            let problem = trial.problem.as_deref().unwrap_or("it leaves out too many views");
            format!("{}: {problem}", trial.model)
        };
        return Err(NoLens { camera: camera.to_owned(), problems: trials.iter().map(problem).collect() });
    };
    let rest: Vec<usize> = usable.iter().copied().filter(|idx| *idx != chosen).collect();
    let this = &trials[chosen];
    let mut why = format!(
        "{} predicts views that took no part to {:.4} px with {} parameters",
        this.model,
        this.held_out_px,
        this.model.param_count()
    );
    if let Some(next) = simplest(&trials, &rest) {
        let next = &trials[next];
        why += &format!(
            "; the runner-up {} to {:.4} px with {}",
            next.model,
            next.held_out_px,
            next.model.param_count()
        );
    }
    for trial in &trials {
        if let Some(problem) = trial.problem.as_ref().filter(|_| trial.held_out_px < this.held_out_px) {
            why += &format!("; {} is refused: {problem}", trial.model);
        }
    }
    Ok(LensSelection { camera: camera.to_owned(), model: this.model, why, trials })
}

/// A difference of the mean square per view is one from so many of its standard errors on.
const SIGNIFICANT: f64 = 2.0;

/// Who predicts worse by more than this share of the error is worse, however few views show it.
const NOTABLE_SHARE: f64 = 0.03;

/// Who predicts better by less than this share of the error is not worth more parameters.
const NEGLIGIBLE_SHARE: f64 = 0.005;

/// Residuals that point the same way by more than this share of the error say that a lens does not fit: 0.35 of the
/// scatter of a coordinate, from where on the finding `biased-residuals` is told.
const BIASED_SHARE: f64 = 0.25;

/// Returns which of the trials is the simplest that is not told from the best, or is hardly worse; and whose residuals
/// point in no common direction, unless the best one's do.
fn simplest(trials: &[ModelTrial], among: &[usize]) -> Option<usize> {
    let views: Vec<&ViewErrors> = among.iter().map(|&idx| &trials[idx].views).collect();
    let ranked: Vec<(usize, f64)> = among.iter().copied().zip(comparable_rms_px(&views)).collect();
    let &(best, best_px) = ranked.iter().min_by(|(_, a_px), (_, b_px)| a_px.total_cmp(b_px))?;
    let is_biased = |idx: usize| trials[idx].bias_px > BIASED_SHARE * trials[idx].held_out_px;
    let is_as_good = |&(idx, rms_px): &(usize, f64)| {
        if is_biased(idx) && !is_biased(best) {
            return false;
        }
        let (mean, error) = excess(&trials[idx].views, &trials[best].views);
        let more = rms_px / best_px - 1.0;
        more <= NEGLIGIBLE_SHARE || (more <= NOTABLE_SHARE && mean <= SIGNIFICANT * error)
    };
    let n_params = |idx: usize| trials[idx].model.param_count();
    let as_good = ranked.into_iter().filter(|trial| trial.0 == best || is_as_good(trial));
    let simplest =
        as_good.min_by(|&(a, a_px), &(b, b_px)| n_params(a).cmp(&n_params(b)).then(a_px.total_cmp(&b_px)));
    simplest.map(|(idx, _)| idx)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use boresight_camera::Camera;
    use boresight_data::Shape;
    use boresight_io::{JobOverrides, load_job};
    use boresight_synthetic::{Recipe, simulate};

    use super::*;
    use crate::CalibrateOptions;

    fn trial(model: &str, squares: &[f64]) -> ModelTrial {
        ModelTrial {
            model: model.parse().unwrap(),
            held_out_px: (squares.iter().sum::<f64>() / (50.0 * squares.len() as f64)).sqrt(),
            bias_px: 0.0,
            problem: None,
            views: squares.iter().map(|square| Some((*square, 50))).collect(),
        }
    }

    #[test]
    fn the_simplest_of_equals_is_chosen_and_a_folding_lens_never() {
        let mut trials = vec![
            trial("opencv4", &[90.0, 95.0, 88.0, 91.0]),
            trial("opencv5", &[50.0, 52.0, 49.0, 51.0]),
            trial("opencv8", &[49.5, 52.2, 49.2, 50.5]),
            trial("opencv12", &[10.0, 11.0, 10.0, 11.0]),
        ];
        trials[3].problem = Some("the lens folds back".to_owned());
        let selection = select("cam", trials.clone()).unwrap();
        assert_eq!(selection.model.name(), "opencv5");
        assert!(selection.why.contains("runner-up opencv8"), "{}", selection.why);
        assert!(selection.why.contains("opencv12 is refused: the lens folds back"), "{}", selection.why);
        let folding = trials.split_off(3);
        assert!(select("cam", folding).unwrap_err().to_string().contains("folds back"));
    }

    #[test]
    fn a_lens_whose_residuals_point_the_same_way_is_not_as_good_as_one_whose_do_not() {
        let mut trials =
            vec![trial("opencv4", &[50.2, 52.0, 49.0, 51.2]), trial("opencv5", &[50.0, 52.0, 49.0, 51.0])];
        let chosen = |trials: &[ModelTrial]| select("cam", trials.to_vec()).unwrap().model.name();
        assert_eq!(chosen(&trials), "opencv4");
        trials[0].bias_px = 0.3 * trials[0].held_out_px;
        assert_eq!(chosen(&trials), "opencv5");
        // Where no lens fits, the simplest will do.
        trials[1].bias_px = trials[0].bias_px;
        assert_eq!(chosen(&trials), "opencv4");
    }

    #[test]
    #[allow(clippy::print_stdout, reason = "a test says what it measured")]
    fn the_recorded_pair_has_no_use_for_rational_lenses() {
        let dataset = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets/opencv-stereo");
        let job = load_job(&[dataset], &JobOverrides::default()).unwrap();
        for shape in [Shape::Rigid, Shape::Parabolic2] {
            let mut dataset = job.dataset.clone();
            dataset.targets.iter_mut().for_each(|target| target.shape = shape);
            for camera in dataset.cameras.ids() {
                let terms = Terms { options: &CalibrateOptions::default(), cancel: None };
                let selection = choose_lens(&dataset, &[camera], terms).unwrap();
                println!("{}: {}", selection.camera, selection.why);
                for trial in &selection.trials {
                    println!("  {} {:.4} px, bias {:.4} px", trial.model, trial.held_out_px, trial.bias_px);
                }
                let name = selection.model.name();
                assert!(!["opencv8", "opencv12", "opencv14"].contains(&name), "{name}: {}", selection.why);
            }
        }
    }

    /// A lens of a known kind, in front of an image of 1600x1200.
    fn lens(model: &str, core: [f64; 4], rest: &[f64]) -> Camera {
        Camera::new(model.parse().unwrap(), [&core[..], rest].concat(), [1600, 1200]).unwrap()
    }

    /// Returns lenses of known kind; the field of view across the diagonal goes from 50 to 180 degrees.
    fn lenses() -> Vec<Camera> {
        let core = [1000.0, 1003.0, 806.0, 594.0];
        vec![
            lens("pinhole", [2100.0, 2104.0, 795.0, 602.0], &[]),
            lens("pinhole", core, &[]),
            lens("opencv4", core, &[-0.15, 0.05, 5e-4, -4e-4]),
            lens("opencv4", [1500.0, 1498.0, 812.0, 588.0], &[-0.25, 0.11, -6e-4, 5e-4]),
            lens("opencv5", core, &[-0.22, 0.08, 4e-4, 3e-4, -0.012]),
            lens("opencv5", [900.0, 902.0, 790.0, 605.0], &[-0.2, 0.07, 0.0, 5e-4, -0.012]),
            lens("opencv8", [800.0, 801.0, 803.0, 598.0], &[0.6, 0.2, 3e-4, -2e-4, 0.01, 0.9, 0.35, 0.03]),
            lens("opencv8", [700.0, 702.0, 799.0, 601.0], &[0.9, 0.3, 0.0, 1e-4, 0.02, 1.2, 0.55, 0.06]),
            lens("opencv12", core, &[-0.1, 0.02, 3e-4, 2e-4, 0.0, 0.05, 0.0, 0.0, 4e-3, -2e-3, -5e-3, 3e-3]),
            lens("kannala-brandt4", [650.0, 651.0, 802.0, 597.0], &[0.03, -0.01, 0.004, -6e-4]),
            lens("kannala-brandt4", [500.0, 500.5, 795.0, 604.0], &[0.02, -0.008, 0.001, -2e-4]),
            lens("double-sphere", [420.0, 421.0, 801.0, 603.0], &[-0.15, 0.58]),
        ]
    }

    /// Checks that the lens chosen is the true one, or as good on views that took no part as that is.
    #[allow(clippy::print_stdout, reason = "a test says what it measured")]
    fn check(places: &[usize]) {
        let lenses = lenses();
        let mut wrong = Vec::new();
        for &i in places {
            let camera = &lenses[i];
            let is_wide = ["kannala-brandt4", "double-sphere"].contains(&camera.model.name());
            let mut recipe = if is_wide { Recipe::fisheye() } else { Recipe::mono() };
            let near = camera.params[0] / 1100.0;
            recipe.placement.distance_m = recipe.placement.distance_m.map(|m| m * near.max(0.6));
            recipe.placement.image_share = 0.85;
            recipe.cameras[0].camera = camera.clone();
            let made = simulate(&recipe, 40 + i as u64);
            let terms = Terms { options: &CalibrateOptions::default(), cancel: None };
            let selection = choose_lens(&made.dataset, &[CameraId(0)], terms).unwrap();
            let of = |model: Model| selection.trials.iter().find(|trial| trial.model == model).unwrap();
            let (chosen, own) = (of(selection.model), of(camera.model));
            println!(
                "{i} {} to {:.4} px{}: {}",
                camera.model,
                own.held_out_px,
                own.problem.as_ref().map_or(String::new(), |problem| format!(" ({problem})")),
                selection.why
            );
            // Noise alone is 0.28 px, so that no other family is let off.
            if chosen.held_out_px > 1.02 * own.held_out_px || chosen.held_out_px > 0.29 {
                wrong.push(i);
            }
        }
        assert_eq!(wrong, Vec::<usize>::new());
    }

    #[test]
    fn lenses_of_known_kind_are_told() {
        check(&[1, 5, 9]);
    }

    /// Heavy: `cargo test -p boresight --lib twelve -- --ignored --nocapture`.
    #[test]
    #[ignore = "tries fourteen models on twelve lenses"]
    fn twelve_lenses_of_known_kind_are_told() {
        check(&(0..12).collect::<Vec<usize>>());
    }
}
