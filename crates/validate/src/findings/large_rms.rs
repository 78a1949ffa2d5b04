//! Residuals that are large for any camera.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};
use crate::statistics::median;

/// A good detector is at 0.1 to 0.3 px, a poor one below this.
const CAUTION_ABOVE_PX: f64 = 1.0;

/// Residuals that no detector explains.
const FAIL_ABOVE_PX: f64 = 3.0;

/// The RMS of a two-dimensional normal distribution over its median length: sqrt(2) / sqrt(2 ln 2).
const RMS_BY_MEDIAN: f64 = 1.201_122_408_786_449_8;

/// Residuals that are large for any camera.
pub(super) struct LargeRms;

impl Diagnostic for LargeRms {
    const CODE: &'static str = "large-rms";

    const EXPLANATION: &'static str = "\
What it means: the typical residual of this camera is large: the root mean
square, as estimated from the median so that a few outliers do not count, is
above 1 px (a caution) or 3 px (a failure). Good images of a good board give 0.1
to 0.3 px.

Why it matters: something is systematically wrong, and the uncertainties cannot
be trusted, because they assume that residuals are noise. A small RMS proves
nothing, but a large one does.

How to fix it: check what was given first: rows and columns of inner corners,
the kind of board, one resolution for all images. Then the lens: a fisheye needs
a fisheye model. Then the images: blur, a board that is not flat (solve for its
shape), automatic focus or image stabilisation that changed the lens between the
images, a rolling shutter. For rigs, check that cameras are synchronised: each
camera calibrates well alone then, and badly together.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(id, name, _)| {
            let residuals = case.used_views_of(id).flat_map(|used| &used.fit.residuals_px);
            let rms_px = RMS_BY_MEDIAN * median(residuals.map(|[u, v]| u.hypot(*v)))?;
            let (severity, limit) = match rms_px {
                rms if rms > FAIL_ABOVE_PX => (Severity::Fail, FAIL_ABOVE_PX),
                rms if rms > CAUTION_ABOVE_PX => (Severity::Caution, CAUTION_ABOVE_PX),
                _ => return None,
            };
            let all_px = case.camera_fit(id).map_or(rms_px, |fit| fit.rms_px);
            Some(Found {
                severity,
                place: name.to_owned(),
                message: format!(
                    "the RMS is {rms_px:.2} px as estimated from the median residual, {all_px:.2} px over all kept \
                     corners"
                ),
                measured: Some(rms_px),
                limit: Some(limit),
                fix: "Check the board's description and the lens model, then blur, flatness and synchronisation."
                    .to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        use boresight_synthetic::Recipe;

        let with = |sigma_px| Example::of(Recipe { sigma_px, ..Recipe::mono() });
        vec![(with(1.2), Severity::Caution), (with(4.0), Severity::Fail)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_gives_the_rms_of_normal_noise() {
        let (example, _) = LargeRms::examples().remove(0);
        let found = LargeRms::find(&Case::new(&example.dataset, &example.calibration));
        let (robust, plain) =
            (found[0].measured.unwrap(), example.calibration.cameras.iter().next().unwrap().rms_px);
        // Over a thousand residuals, the median is good to a few percent.
        assert!((robust / plain - 1.0).abs() < 0.05, "{robust} {plain}");
    }

    #[test]
    fn a_few_outliers_do_not_count() {
        let mut example = Example::mono();
        for view in &mut example.dataset.views {
            view.observations.iter_mut().step_by(8).for_each(|observation| observation.pixel[0] += 100.0);
        }
        example.refit();
        assert!(LargeRms::find(&Case::new(&example.dataset, &example.calibration)).is_empty());
    }
}
