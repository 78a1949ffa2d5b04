//! Frames that were left out are predicted worse than those that were used.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The ratio of the errors, per degree of freedom, above which a calibration does not carry over well.
/// Noise alone gives one, and a percent or two more where there are few frames.
const CAUTION_ABOVE: f64 = 1.25;

/// The ratio above which it describes its own frames and hardly any other.
const FAIL_ABOVE: f64 = 2.0;

/// Frames that were left out are predicted worse than those that were used.
pub(super) struct HeldOut;

impl Diagnostic for HeldOut {
    const CODE: &'static str = "held-out";

    const EXPLANATION: &'static str = "\
What it means: the calibration was repeated without a part of the frames, part
after part, and each time the frames left out were predicted: lenses, rig and
target as the others gave them, and only the pose of the target in each frame
fitted to its corners. Their error, per degree of freedom, is more than 1.25
times (a caution) or twice (a failure) that of the frames in the solve.

Why it matters: the error on frames that took part says how well the model can
bend to them. The error on frames that did not is what happens in use. Where the
two differ, the data were too few for the parameters, or single frames are
unlike all others (a corner of the image that only they cover, a blur, a pair of
images that was not taken at the same time).

How to fix it: add frames, above all where only one or two cover a part of the
image. Look at the views with the largest residuals and leave out what is
blurred or out of step. If the ratio stays, take a lens with fewer parameters.";

    fn find(case: &Case) -> Vec<Found> {
        let Some(held_out) = &case.calibration.held_out else { return Vec::new() };
        let (severity, limit) = match held_out.ratio {
            ratio if ratio > FAIL_ABOVE || ratio.is_nan() => (Severity::Fail, FAIL_ABOVE),
            ratio if ratio > CAUTION_ABOVE => (Severity::Caution, CAUTION_ABOVE),
            _ => return Vec::new(),
        };
        vec![Found {
            severity,
            place: "held-out".to_owned(),
            message: format!(
                "frames left out of the solve are met to {:.4} px, those in it to {:.4} px: {:.2} times",
                held_out.rms_px, held_out.in_sample_rms_px, held_out.ratio
            ),
            measured: Some(held_out.ratio),
            limit: Some(limit),
            fix: "Add frames, above all where few cover a part of the image, or take a simpler lens model."
                .to_owned(),
        }]
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let with = |ratio: f64| {
            let mut example = Example::mono();
            example.calibration.held_out = Some(boresight_data::HeldOut {
                folds: 5,
                frames: 40,
                rms_px: 0.2 * ratio,
                in_sample_rms_px: 0.2,
                ratio,
                ..Default::default()
            });
            example
        };
        vec![(with(1.4), Severity::Caution), (with(3.0), Severity::Fail), (with(f64::NAN), Severity::Fail)]
    }
}
