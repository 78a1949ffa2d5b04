//! The solver did not reach the optimum.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The solver did not reach the optimum.
pub(super) struct NotConverged;

impl Diagnostic for NotConverged {
    const CODE: &'static str = "not-converged";

    const EXPLANATION: &'static str = "\
What it means: the solver stopped before it reached the best fit: it ran out of
iterations or time, was interrupted, or could not find a step that improves the
fit. The message quotes the evidence.

Why it matters: the parameters are somewhere on the way. Residuals may look fine
already while focal lengths and poses are still moving, and the sigmas are those
of a place that is not the optimum.

How to fix it: raise the limit on iterations or time first. If that does not
help, the data usually leave something undetermined: look at the other findings
(few views, little tilt, a singular covariance), try a lens model with fewer
parameters, or a regularisation. A start that is far off is rare, because no
focal length is asked for; it shows as views that are left out or fit badly.";

    fn find(case: &Case) -> Vec<Found> {
        let solve = &case.calibration.solve;
        if solve.converged {
            return Vec::new();
        }
        vec![Found {
            severity: Severity::Fail,
            place: "solve".to_owned(),
            message: format!(
                "the solver stopped after {} iterations before it reached the optimum: {}",
                solve.iterations, solve.stop
            ),
            measured: None,
            limit: None,
            fix: "Raise the limit on iterations or time; if it still stops early, add views or take a simpler lens \
                  model."
                .to_owned(),
        }]
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        example.calibration.solve.converged = false;
        vec![(example, Severity::Fail)]
    }
}
