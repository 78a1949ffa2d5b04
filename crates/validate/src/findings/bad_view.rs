//! A view that fits much worse than the others.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};
use crate::statistics::median;

/// How many times the median of its camera's views a view's RMS may be.
const CAUTION_ABOVE: f64 = 3.0;

/// The share of a view's corners that may be rejected.
const REJECTED_ABOVE: f64 = 0.5;

/// With fewer views the median is one of the bad ones itself.
const MIN_VIEWS: usize = 4;

/// Residuals below this many pixels are rounding or interpolation, whatever their ratio.
const NEGLIGIBLE_PX: f64 = 0.01;

/// A view that fits much worse than the others.
pub(super) struct BadView;

impl Diagnostic for BadView {
    const CODE: &'static str = "bad-view";

    const EXPLANATION: &'static str = "\
What it means: the residuals of one view are more than three times those of the
camera's median view (root mean square over the corners that were kept), or more
than half of its corners were rejected as outliers.

Why it matters: the view was not made under the assumptions of the others.
Typical causes: blur or motion during the exposure, a rolling shutter and a
moving board, a board that was bent in the hand, a detection that is shifted by
one square or counted from the wrong corner, an image of another camera or
resolution, cameras that did not look at the same time. Such a view pulls on
everything, and on the pose of its own frame most of all.

How to fix it: look at the image with its corners. Remove it and calibrate
again; if other views become bad in turn, the cause is in all of them, or the
lens model is too simple. Mount the board or let it rest, light it well, and
keep the exposure short.";

    fn find(case: &Case) -> Vec<Found> {
        let mut found = Vec::new();
        for (id, _, _) in case.cameras() {
            let rms = || case.used_views_of(id).filter_map(|used| used.fit.rms_px);
            let typical_px = (rms().count() >= MIN_VIEWS).then(|| median(rms())).flatten();
            for used in case.used_views_of(id) {
                let n_rejected = case.outliers_in(used.index);
                let share = n_rejected as f64 / used.view.observations.len().max(1) as f64;
                let ratio = typical_px.zip(used.fit.rms_px).filter(|(_, rms_px)| *rms_px > NEGLIGIBLE_PX);
                let (message, measured, limit) = match ratio {
                    Some((typical_px, rms_px)) if rms_px > CAUTION_ABOVE * typical_px => (
                        format!("RMS {rms_px:.2} px, while the camera's median view has {typical_px:.2} px"),
                        rms_px,
                        CAUTION_ABOVE * typical_px,
                    ),
                    _ if share > REJECTED_ABOVE => (
                        format!("{n_rejected} of {} corners were rejected", used.view.observations.len()),
                        share,
                        REJECTED_ABOVE,
                    ),
                    _ => continue,
                };
                found.push(Found {
                    severity: Severity::Caution,
                    place: case.view_name(used.view),
                    message,
                    measured: Some(measured),
                    limit: Some(limit),
                    fix: "Look at the image for blur, motion or a shifted detection; remove it and calibrate again."
                        .to_owned(),
                });
            }
        }
        found
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut blurred = Example::mono();
        for (i, observation) in blurred.dataset.views[3].observations.iter_mut().enumerate() {
            observation.pixel[i % 2] += if i % 4 < 2 { 1.5 } else { -1.5 };
        }
        blurred.refit();
        let mut shifted = Example::mono();
        let n = shifted.dataset.views[5].observations.len();
        shifted.reject(5, n * 2 / 3);
        vec![(blurred, Severity::Caution), (shifted, Severity::Caution)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_bad_view_is_named() {
        let (example, _) = BadView::examples().remove(0);
        let found = BadView::find(&Case::new(&example.dataset, &example.calibration));
        let places: Vec<&str> = found.iter().map(|found| found.place.as_str()).collect();
        assert_eq!(places, ["cam0, frame frame003"]);
    }

    #[test]
    fn rounding_is_not_bad() {
        let mut example = Example::mono();
        for (i, view) in example.calibration.views.iter_mut().enumerate() {
            view.rms_px = Some(if i == 0 { 1e-4 } else { 1e-9 });
        }
        assert!(BadView::find(&Case::new(&example.dataset, &example.calibration)).is_empty());
    }
}
