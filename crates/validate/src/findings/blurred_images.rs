//! Images in which corners are found less exactly than in others.

use boresight_data::{CameraId, Severity, View};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};
use crate::statistics::median;

/// A view whose sigma is this many times that of its camera's middle view is blurred.
const TIMES: f64 = 2.0;
/// Views below this sigma are sharp enough, however sharp others are, in pixels.
const SHARP_PX: f64 = 0.02;
/// The sigma of a camera's middle view above which all of it is blurred, in pixels.
const CAUTION_ABOVE_PX: f64 = 0.15;
/// As many images are named.
const NAMED: usize = 4;

/// Images in which corners are found less exactly than in others.
pub(super) struct BlurredImages;

impl Diagnostic for BlurredImages {
    const CODE: &'static str = "blurred-images";

    const EXPLANATION: &'static str = "\
What it means: the sigma of a corner is told by the image around it: blur, noise
and little light make it larger. In the views named it is more than twice that
of the camera's middle view; or that of the middle view itself is above 0.15 px,
where 0.01 to 0.04 px are usual: all of the camera's images are blurred, noisy
or dark.

Why it matters: corners are weighed by their sigmas, so a blurred image spoils
little, but tells little too. Blur by motion is worse than its sigma says: it
moves all corners of a view in one direction, and with a rolling shutter it
bends the board. If all images are blurred, the focus or the exposure is wrong.

How to fix it: hold the board still or put it down, give more light, shorten the
exposure, and focus at the distance of use before calibrating; never change the
focus afterwards. Images that are blurred by motion are best removed.";

    fn find(case: &Case) -> Vec<Found> {
        let mut found = Vec::new();
        for (id, name, _) in case.cameras() {
            let Some(middle) = middle_sigma_px(case, id) else { continue };
            if middle > CAUTION_ABOVE_PX {
                found.push(Found {
                    severity: Severity::Caution,
                    place: name.to_owned(),
                    message: format!("a corner is known to {middle:.2} px in the middle of its views"),
                    measured: Some(middle),
                    limit: Some(CAUTION_ABOVE_PX),
                    fix: "Focus the camera, give more light, and hold the board still.".to_owned(),
                });
            }
            let limit = (TIMES * middle).max(SHARP_PX);
            let is_blurred = |view: &&View| sigma_px(view).is_some_and(|sigma| sigma > limit);
            let blurred: Vec<&View> =
                case.used_views_of(id).map(|used| used.view).filter(is_blurred).collect();
            if blurred.is_empty() {
                continue;
            }
            let named: Vec<String> = blurred.iter().take(NAMED).map(|view| case.view_name(view)).collect();
            let more = if blurred.len() > NAMED { ", ..." } else { "" };
            let worst = blurred.iter().filter_map(|view| sigma_px(view)).fold(0.0, f64::max);
            found.push(Found {
                severity: Severity::Note,
                place: name.to_owned(),
                message: format!(
                    "{} blurred beside the others, with up to {worst:.2} px for a corner where {middle:.3} px are \
                     usual: {}{more}",
                    if blurred.len() == 1 { "1 view is".to_owned() } else { count(blurred.len(), "view") + " are" },
                    named.join(", ")
                ),
                measured: Some(worst),
                limit: Some(limit),
                fix: "Look at them, and remove those that are blurred by motion.".to_owned(),
            });
        }
        found
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        // As a detector tells them: all differ.
        let sharp = |scale: f64| {
            let mut example = Example::mono();
            for view in &mut example.dataset.views {
                for (i, observation) in view.observations.iter_mut().enumerate() {
                    observation.sigma_px = scale * (1.0 + 0.01 * i as f64);
                }
            }
            example
        };
        let mut one = sharp(0.04);
        one.dataset.views[5].observations.iter_mut().for_each(|observation| observation.sigma_px *= 5.0);
        vec![(one, Severity::Note), (sharp(0.5), Severity::Caution)]
    }
}

/// Returns the median of the sigmas of a view's corners.
fn sigma_px(view: &View) -> Option<f64> {
    median(view.observations.iter().map(|observation| observation.sigma_px))
}

/// Returns the sigma of a camera's middle view, or `None` if its sigmas were stated and are not told by images.
pub(crate) fn middle_sigma_px(case: &Case, camera: CameraId) -> Option<f64> {
    if case.sigmas_are_stated(camera) {
        return None;
    }
    median(case.used_views_of(camera).filter_map(|used| sigma_px(used.view)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stated_sigmas_tell_nothing_of_blur() {
        let mut example = Example::mono();
        for (i, view) in example.dataset.views.iter_mut().enumerate() {
            // Levels of an image pyramid.
            let sigma_px = if i % 10 == 0 { 4.0 } else { 1.0 };
            view.observations.iter_mut().for_each(|observation| observation.sigma_px = sigma_px);
        }
        let case = Case::new(&example.dataset, &example.calibration);
        assert_eq!(middle_sigma_px(&case, CameraId(0)), None);
        assert!(BlurredImages::find(&case).is_empty());
    }
}
