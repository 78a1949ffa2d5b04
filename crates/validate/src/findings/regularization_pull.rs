//! A regularisation that fights the data.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The share of the cost above which a belief is no longer mild. mrcal warns at the same share.
const CAUTION_ABOVE: f64 = 0.01;

/// A regularisation that fights the data.
pub(super) struct RegularizationPull;

impl Diagnostic for RegularizationPull {
    const CODE: &'static str = "regularization-pull";

    const EXPLANATION: &'static str = "\
What it means: more than 1 % of the cost (chi-squared) at the solution comes
from the regularisation, the mild belief that high-order coefficients are near
zero, and not from the observations.

Why it matters: a regularisation is there to decide what the data leave open.
When it costs much, the data want something else and are overruled: the lens is
biased towards having less distortion. The residuals grow a little; the
uncertainties do not know about it. It is also how a wrong lens model shows: the
coefficients must be huge to follow the lens.

How to fix it: if the lens is really that strong, solve without regularisation
and see whether the covariance still exists; if so, leave it off. Otherwise take
another model: for more than about 100 degrees, a fisheye model instead of a
rational one. With few observations, take more views: the belief weighs less
against them.";

    fn find(case: &Case) -> Vec<Found> {
        let regularization = &case.calibration.regularization;
        let share = regularization.chi2 / case.calibration.solve.chi2;
        // NaN where there is no cost at all.
        if regularization.rows == 0 || share.is_nan() || share <= CAUTION_ABOVE {
            return Vec::new();
        }
        vec![Found {
            severity: Severity::Caution,
            place: "regularization".to_owned(),
            message: format!(
                "the {} regularisation makes up {:.1} % of the cost with {} rows: it pulls against the data",
                regularization.kind,
                100.0 * share,
                regularization.rows
            ),
            measured: Some(share),
            limit: Some(CAUTION_ABOVE),
            fix: "Solve without regularisation if the covariance allows it, or take a lens model that suits the lens."
                .to_owned(),
        }]
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        example.calibration.regularization.chi2 = 0.02 * example.calibration.solve.chi2;
        vec![(example, Severity::Caution)]
    }
}
