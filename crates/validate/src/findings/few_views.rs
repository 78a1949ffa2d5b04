//! A camera with few views.

use boresight_data::Severity;

use super::case::{Case, normal_in_target};
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};

/// Below this many views of a flat target, five to nine lens parameters are barely determined.
const FAIL_BELOW: usize = 3;

/// Below this many, a single bad view can still bend the result.
const CAUTION_BELOW: usize = 8;

/// A camera with few views.
pub(super) struct FewViews;

impl Diagnostic for FewViews {
    const CODE: &'static str = "few-views";

    const EXPLANATION: &'static str = "\
What it means: few views of this camera took part in the solve: fewer than 8 is
a caution, fewer than 3 of a flat board a failure. Views that were left out do
not count, and neither does a camera whose lens was given and held.

Why it matters: every view brings six unknowns of its own, the pose of the
board, and a flat board tells little about the lens from one side. Two views of
a flat board can just determine a focal length and a principal point if nothing
goes wrong, and no residual will show it if something does. With few views one
blurred image bends everything, and the uncertainty is itself uncertain.

How to fix it: take more views; 20 to 40 are usual, and 10 good ones are far
better than none. Let each differ from the others: tilt the board by 20 to 45
degrees to either side, roll it, come close so that it fills the image, and go
into every corner. If views were left out, find out why first.";

    fn find(case: &Case) -> Vec<Found> {
        let estimated = case.cameras().filter(|(_, name, _)| !case.lens_is_held(name));
        estimated
            .filter_map(|(camera, name, _)| {
                let n_views = case.used_views_of(camera).count();
                // Points in space tell in one view what a board tells in several.
                let sees_solid = case.used_views_of(camera).any(|used| {
                    case.target(used.view).is_some_and(|target| normal_in_target(target).is_none())
                });
                let (severity, limit) = match n_views {
                    n if n < FAIL_BELOW && !sees_solid => (Severity::Fail, FAIL_BELOW),
                    n if n < CAUTION_BELOW && !(sees_solid && n >= FAIL_BELOW) => {
                        (Severity::Caution, if sees_solid { FAIL_BELOW } else { CAUTION_BELOW })
                    }
                    _ => return None,
                };
                Some(Found {
                    severity,
                    place: name.to_owned(),
                    message: format!("only {} of this camera can be used", count(n_views, "view")),
                    measured: Some(n_views as f64),
                    limit: Some(limit as f64),
                    fix: "Take 20 or more views that differ in tilt, roll, distance and place in the image."
                        .to_owned(),
                })
            })
            .collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let with = |n_views| {
            let mut example = Example::mono();
            example.retain_views(|view_idx| view_idx < n_views);
            example
        };
        vec![(with(2), Severity::Fail), (with(7), Severity::Caution)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lens_that_is_held_needs_no_views() {
        let mut example = Example::stereo();
        example.retain_views(|view_idx| view_idx < 8);
        let found = FewViews::find(&Case::new(&example.dataset, &example.calibration));
        let places: Vec<&str> = found.iter().map(|found| found.place.as_str()).collect();
        assert_eq!(places, ["cam0", "cam1"]);
        let uncertainty = &mut example.calibration.uncertainty;
        for name in uncertainty.names.iter_mut().filter(|name| name.starts_with("cam1.")) {
            *name = name.replace("cam1.", "cam1.cam_from_rig.");
        }
        let found = FewViews::find(&Case::new(&example.dataset, &example.calibration));
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].place.as_str(), found[0].limit), ("cam0", Some(8.0)));
    }
}
