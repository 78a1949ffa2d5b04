//! Cameras and views that took no part.

use std::collections::BTreeMap;

use boresight_data::{CameraId, RejectionReason, Severity};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};

/// The share of a camera's views that may be left out without more than a note.
const CAUTION_ABOVE: f64 = 0.1;

/// Cameras and views that took no part.
pub(super) struct LeftOut;

impl Diagnostic for LeftOut {
    const CODE: &'static str = "left-out";

    const EXPLANATION: &'static str = "\
What it means: a camera could not be calibrated, or some views took no part in
the solve. Typical reasons: the camera shares no frame with the others, it has
too few views for a start, or the pose of a board could not be found, because
too few of its corners were seen or they contradict each other. A few views that
are left out are a note; more than a tenth of a camera's views, or a whole
camera, are a caution.

Why it matters: the result is about less than what was given. A camera that is
missing has neither lens nor place in the rig. Views that are left out often
point to a mistake in the set-up: the size of the board, rows and columns
exchanged, images of another resolution.

How to fix it: for a camera, take frames in which it and a calibrated camera see
the board at once, and at least eight views of it alone. For views, look at the
images named, and check the board's description: count inner corners, not
squares. A few bad images are best removed.";

    fn find(case: &Case) -> Vec<Found> {
        let left_out = views_left_out(case);
        let mut found = Vec::new();
        for (id, info) in case.dataset.cameras.enumerate() {
            let n_views = case.dataset.views.iter().filter(|view| view.camera == id).count();
            let views = left_out.get(&id).map_or(&[][..], Vec::as_slice);
            let is_calibrated = case.calibration.scene.rig.cameras.get(id).is_some_and(Option::is_some);
            if !is_calibrated {
                let why = match views.first() {
                    Some((_, why)) => (*why).to_owned(),
                    None if n_views == 0 => "it has no views".to_owned(),
                    None => format!("none of its {} could be used", count(n_views, "view")),
                };
                found.push(Found {
                    severity: Severity::Caution,
                    place: info.name.clone(),
                    message: format!("the camera is not calibrated: {why}"),
                    measured: None,
                    limit: None,
                    fix: "Take frames in which this and a calibrated camera see the board at once, and eight or more \
                          views of it."
                        .to_owned(),
                });
                continue;
            }
            let Some((first, why)) = views.first() else { continue };
            let share = views.len() as f64 / n_views.max(1) as f64;
            let first = case.dataset.views.get(*first).map_or(String::new(), |view| case.view_name(view));
            found.push(Found {
                severity: if share > CAUTION_ABOVE { Severity::Caution } else { Severity::Note },
                place: info.name.clone(),
                message: format!(
                    "{} of {} took no part, such as {first}: {why}",
                    views.len(),
                    count(n_views, "view")
                ),
                measured: Some(share),
                limit: Some(CAUTION_ABOVE),
                fix: format!(
                    "Look at {first}; check the board's size and description, or remove such images."
                ),
            });
        }
        found
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut one = Example::mono();
        one.leave_out(4, "the target's pose in its frame could not be found");
        let mut many = one.clone();
        (10..20).for_each(|view_idx| {
            many.leave_out(view_idx, "the target's pose in its frame could not be found")
        });
        let mut camera = Example::stereo();
        camera.calibration.scene.rig.cameras[CameraId(1)] = None;
        camera.refit();
        vec![(one, Severity::Note), (many, Severity::Caution), (camera, Severity::Caution)]
    }
}

/// Returns the views that were left out and why, by camera.
fn views_left_out<'a>(case: &Case<'a>) -> BTreeMap<CameraId, Vec<(usize, &'a str)>> {
    let mut by_view: BTreeMap<usize, &str> = BTreeMap::new();
    for rejection in &case.calibration.rejected {
        if let RejectionReason::LeftOut { why } = &rejection.reason {
            by_view.entry(rejection.view_idx).or_insert(why);
        }
    }
    let mut by_camera: BTreeMap<CameraId, Vec<(usize, &str)>> = BTreeMap::new();
    for (view_idx, why) in by_view {
        if let Some(view) = case.dataset.views.get(view_idx) {
            by_camera.entry(view.camera).or_default().push((view_idx, why));
        }
    }
    by_camera
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_which_and_why() {
        let mut example = Example::mono();
        example.dataset.views[4].image = Some("img04.png".to_owned());
        example.leave_out(4, "fewer than four corners");
        let found = LeftOut::find(&Case::new(&example.dataset, &example.calibration));
        assert_eq!(found.len(), 1);
        assert_eq!(
            found[0].message,
            "1 of 40 views took no part, such as img04.png: fewer than four corners"
        );
    }

    #[test]
    fn a_camera_that_is_missing_is_one_finding() {
        let mut example = Example::stereo();
        example.calibration.scene.rig.cameras[CameraId(1)] = None;
        for view_idx in 0..example.dataset.views.len() {
            if example.dataset.views[view_idx].camera == CameraId(1) {
                example.leave_out(view_idx, "its camera could not be calibrated");
            }
        }
        let found = LeftOut::find(&Case::new(&example.dataset, &example.calibration));
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].message, "the camera is not calibrated: its camera could not be calibrated");
    }
}
