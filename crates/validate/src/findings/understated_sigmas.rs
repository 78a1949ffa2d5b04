//! Sigmas of corners, as images tell them, that are too small for the residuals.

use boresight_data::{CameraId, Severity};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// Residuals that scatter by more than this many of the sigmas that are told have another cause than what the image tells.
const TIMES: f64 = 2.0;
/// One in so many corners is among those with the smallest sigmas, whose weight is told.
const HEAVIEST: usize = 10;

/// Sigmas of corners, as images tell them, that are too small for the residuals.
pub(super) struct UnderstatedSigmas;

impl Diagnostic for UnderstatedSigmas {
    const CODE: &'static str = "understated-sigmas";

    const EXPLANATION: &'static str = "\
What it means: the sigma of a corner is told by the image around it: how well
its edges can be placed beside noise and blur. The residuals of this camera
scatter by the number that is told times as much. What the image cannot tell
makes up the rest: how true the board is printed and how flat it is, a lens that
the model does not follow, blur by motion, rolling shutters.

Why it matters: every sigma of the result is multiplied by such a factor, so
that it fits what is seen. But what is left is not noise: neighbouring corners
are wrong alike, and more corners or images do not average it away as they
would noise. Take the sigmas of the result for the least that there is, and the
error on frames left out for what to expect. Corners are still weighed by their
own sigmas; how much of the weight the sharpest tenth of them has is told.

How to fix it: use a board that is flat, stiff and printed true (an estimated
shape helps, --shape), a lens model that fits (--model auto), and images
without motion.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(id, name, _)| {
            let Scatter { times, heaviest } = scatter(case, id)?;
            (times > TIMES).then(|| Found {
                severity: Severity::Note,
                place: name.to_owned(),
                message: format!(
                    "the residuals scatter by {times:.1} times the sigmas that the images tell; the tenth of the corners \
                     with the smallest has {:.0} % of the weight",
                    100.0 * heaviest
                ),
                measured: Some(times),
                limit: Some(TIMES),
                fix: "Take sigmas of the result as the least there is; a flatter, truer board or another lens model may \
                      tell why."
                    .to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        // Sigmas as a detector tells them, a fifth of what is true.
        let mut example = Example::mono();
        for view in &mut example.dataset.views {
            for (i, observation) in view.observations.iter_mut().enumerate() {
                observation.sigma_px *= 0.2 * (1.0 + 0.001 * i as f64);
            }
        }
        vec![(example, Severity::Note)]
    }
}

/// How the residuals of a camera scatter.
struct Scatter {
    /// The root mean square of its residuals, each in sigmas.
    times: f64,
    /// The share of the weight that the tenth of the corners with the smallest sigmas has.
    heaviest: f64,
}

/// Returns how the kept residuals of a camera scatter, or `None` if its sigmas were not told by images.
fn scatter(case: &Case, camera: CameraId) -> Option<Scatter> {
    if case.sigmas_are_stated(camera) {
        return None;
    }
    let mut sum = 0.0;
    let mut sigmas = Vec::new();
    for used in case.used_views_of(camera) {
        for (observation, residual) in case.kept_with_residuals(used) {
            let sigma_px = observation.sigma_px;
            if sigma_px > 0.0 {
                sum += residual.iter().map(|r| (r / sigma_px).powi(2)).sum::<f64>();
                sigmas.push(sigma_px);
            }
        }
    }
    sigmas.sort_by(f64::total_cmp);
    let weight = |sigmas: &[f64]| sigmas.iter().map(|sigma| sigma.powi(-2)).sum::<f64>();
    let heaviest = weight(&sigmas[..sigmas.len().div_ceil(HEAVIEST)]) / weight(&sigmas);
    Some(Scatter { times: (sum / (2 * sigmas.len()) as f64).sqrt(), heaviest })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmas_that_were_stated_are_none_of_the_images() {
        let mut example = Example::mono();
        for observation in example.dataset.views.iter_mut().flat_map(|view| &mut view.observations) {
            observation.sigma_px = 0.01;
        }
        let case = Case::new(&example.dataset, &example.calibration);
        assert!(UnderstatedSigmas::find(&case).is_empty());
    }

    #[test]
    fn how_many_times_too_small_they_are_is_told_with_their_weight() {
        let mut example = Example::mono();
        let told =
            |example: &Example| scatter(&Case::new(&example.dataset, &example.calibration), CameraId(0));
        for view in &mut example.dataset.views {
            for (i, observation) in view.observations.iter_mut().enumerate() {
                observation.sigma_px *= 1.0 + 1e-6 * i as f64;
            }
        }
        let right = told(&example).expect("they all differ");
        assert!((right.times - 1.0).abs() < 0.05 && (right.heaviest - 0.1).abs() < 0.01, "{}", right.times);
        // One corner of a view that seems ten times better known than the others outweighs them all.
        for view in &mut example.dataset.views {
            view.observations[0].sigma_px *= 0.1;
        }
        let n = example.dataset.views[0].observations.len() as f64;
        let wrong = told(&example).expect("they all differ");
        let expected = (100.0 + 0.1 * n - 1.0) / (100.0 + n - 1.0);
        assert!((wrong.heaviest - expected).abs() < 0.05, "{} {expected}", wrong.heaviest);
        assert!(wrong.times > 1.2 * right.times);
    }
}
