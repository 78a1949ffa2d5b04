//! The data leave something undetermined.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The data leave something undetermined.
pub(super) struct NoCovariance;

impl Diagnostic for NoCovariance {
    const CODE: &'static str = "no-covariance";

    const EXPLANATION: &'static str = "\
What it means: no uncertainty could be computed, because the observations do not
determine all unknowns: some combination of parameters can change without moving
any predicted corner by a noticeable amount. The message names the parameters
that move most along it. The same happens when there are no more equations than
unknowns.

Why it matters: the values along that direction are arbitrary, whatever the
residuals look like. The calibration can still be right where the data are, and
be far off anywhere else. An uncertainty of zero would be a lie, so none is
given.

How to fix it: add views that tell the named parameters apart. A focal length
and the distance of the board are told apart by tilt; a principal point and the
turn of the camera by views that are rolled by 90 degrees; high-order distortion
by corners near the borders of the image. Otherwise take a lens model with fewer
parameters, hold what is known, or regularise.";

    fn find(case: &Case) -> Vec<Found> {
        let uncertainty = &case.calibration.uncertainty;
        let Some(why) = uncertainty.unavailable.as_ref().filter(|_| uncertainty.covariance.is_empty()) else {
            return Vec::new();
        };
        vec![Found {
            severity: Severity::Caution,
            place: "uncertainty".to_owned(),
            message: format!("there is no uncertainty: {why}"),
            measured: None,
            limit: None,
            fix: "Add views that tell these parameters apart (tilted, rolled, near the borders), or take a simpler \
                  lens model."
                .to_owned(),
        }]
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        let uncertainty = &mut example.calibration.uncertainty;
        uncertainty.names.clear();
        uncertainty.covariance.clear();
        let why = "the data do not constrain cam0.k3: reciprocal condition 1e-20 is below 1e-14";
        uncertainty.unavailable = Some(why.to_owned());
        vec![(example, Severity::Caution)]
    }
}
