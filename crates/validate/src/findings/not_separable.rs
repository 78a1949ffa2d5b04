//! Parameters that the data hardly tell apart.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// Parameters that the data hardly tell apart.
pub(super) struct NotSeparable;

impl Diagnostic for NotSeparable {
    const CODE: &'static str = "not-separable";

    const EXPLANATION: &'static str = "\
What it means: some parameters can change together with hardly any effect on the
predicted corners. What is known of this combination is thousands of times worse
than what would be known of the same parameters one by one. The message names
them; the calibration holds each one's share and the ratio.

Why it matters: along such a direction the values are what noise made of them.
Their sigmas say so, and where the corners are, projections are good all the
same. But a parameter taken by itself means little, two calibrations of the same
camera differ in it, and away from the corners the lens may be far off.

How to fix it: a focal length and a distance are told apart by tilting the
board; a principal point and the turn of a camera by tilt and by rolling the
board by 90 degrees between views; two cameras' places by boards that both see;
distortion coefficients by corners near the borders of the image. Or take a lens
model with fewer parameters, or hold one of those named.";

    fn find(case: &Case) -> Vec<Found> {
        let loose = case.calibration.uncertainty.loose.iter();
        let found = loose.map(|direction| Found {
            severity: Severity::Note,
            place: direction.parts.first().map_or("parameters", |(name, _)| name.as_str()).to_owned(),
            message: direction.words.clone(),
            measured: Some(direction.inflation),
            limit: None,
            fix: "Add views that tell these parameters apart, or take a lens model with fewer parameters."
                .to_owned(),
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        example.calibration.uncertainty.loose = vec![boresight_data::LooseDirection {
            inflation: 1e4,
            parts: vec![("cam0.k2".to_owned(), 0.6), ("cam0.k3".to_owned(), 0.4)],
            words: "k2 and k3 of cam0 are not separable: bring corners to the borders".to_owned(),
        }];
        vec![(example, Severity::Note)]
    }
}
