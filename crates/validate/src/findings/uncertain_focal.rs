//! A focal length that is not well known.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The sigma of a focal length, relative to it, above which distances become doubtful.
const CAUTION_ABOVE: f64 = 0.005;

/// The sigma above which there is hardly a focal length at all.
const FAIL_ABOVE: f64 = 0.03;

/// A focal length that is not well known.
pub(super) struct UncertainFocal;

impl Diagnostic for UncertainFocal {
    const CODE: &'static str = "uncertain-focal";

    const EXPLANATION: &'static str = "\
What it means: the standard deviation of fx or fy, as the observations and their
noise give it, is more than 0.5 % of the value (a caution) or more than 3 % (a
failure). Calibrations that are taken with care reach 0.02 to 0.1 %.

Why it matters: a focal length that is off by a percent puts everything off by a
percent: distances from a known size, angles, the overlap of two cameras. The
number counts random noise only; what the model cannot describe comes on top, so
the true error is rather larger.

How to fix it: tilt the board more (20 to 45 degrees, about both axes): tilt is
what separates focal length and distance. Come closer, so that perspective is
strong and corners are many. Take more views; the sigma falls with the root of
their number only, so better views help sooner. A larger or finer board helps
too, and so does a lens model with fewer parameters.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(_, name, placed)| {
            let params = placed.camera.model.param_names().into_iter().zip(&placed.camera.params);
            let focals = params.filter(|(param, _)| ["fx", "fy"].contains(param));
            let relative = focals.filter_map(|(param, value)| {
                let sigma = case.sigma(&format!("{name}.{param}"))?;
                // A variance below zero has no root; it counts as no knowledge.
                let relative = if sigma.is_nan() { f64::INFINITY } else { sigma / value };
                Some((param, *value, sigma, relative))
            });
            let (param, value, sigma, relative) = relative.max_by(|one, other| one.3.total_cmp(&other.3))?;
            let (severity, limit) = match relative {
                r if r > FAIL_ABOVE => (Severity::Fail, FAIL_ABOVE),
                r if r > CAUTION_ABOVE => (Severity::Caution, CAUTION_ABOVE),
                _ => return None,
            };
            Some(Found {
                severity,
                place: name.to_owned(),
                message: format!(
                    "{param} is {value:.1} px with a sigma of {sigma:.1} px, that is {:.1} %",
                    100.0 * relative
                ),
                measured: Some(relative),
                limit: Some(limit),
                fix: "Add views that are close and tilted by 20 to 45 degrees about either axis.".to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let with = |variance: f64| {
            let mut example = Example::mono();
            // Only fy.
            let n = example.calibration.uncertainty.names.len();
            example.calibration.uncertainty.covariance[n + 1] = variance;
            example
        };
        vec![
            (with(10.0 * 10.0), Severity::Caution),
            (with(60.0 * 60.0), Severity::Fail),
            (with(-1.0), Severity::Fail),
        ]
    }
}
