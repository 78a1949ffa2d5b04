//! Many corners were rejected as outliers.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The share of outliers above which something besides chance is wrong.
const CAUTION_ABOVE: f64 = 0.03;

/// The share above which what is left may be the wrong part.
const FAIL_ABOVE: f64 = 0.15;

/// Many corners were rejected as outliers.
pub(super) struct ManyRejected;

impl Diagnostic for ManyRejected {
    const CODE: &'static str = "many-rejected";

    const EXPLANATION: &'static str = "\
What it means: more than 3 % (a caution) or 15 % (a failure) of this camera's
corners were rejected because they lie too far from where the solution says.
Views that were left out as a whole are another finding. The message names the
view that lost the largest share.

Why it matters: noise alone puts one corner in a thousand that far. More are
gross errors of the detection, blurred images, a board that moved during the
exposure, cameras that did not look at the same time, or a lens model that
cannot follow the lens; in that last case it is the good corners, those near the
border, that are thrown away, and the residuals look better than they should.

How to fix it: look at the named view. If whole images are bad, remove them and
take new ones with short exposure and a still board. If outliers crowd at the
borders of all images, take a lens model with more parameters. If they occur in
two cameras together, check the synchronisation.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(id, name, _)| {
            let (mut n_outliers, mut n_all) = (0, 0);
            let mut worst: Option<(f64, usize)> = None;
            for used in case.used_views_of(id) {
                let n = used.view.observations.len();
                let outliers = case.outliers_in(used.index);
                n_outliers += outliers;
                n_all += n;
                let share = outliers as f64 / n.max(1) as f64;
                if worst.is_none_or(|(most, _)| share > most) {
                    worst = Some((share, used.index));
                }
            }
            let share = n_outliers as f64 / n_all.max(1) as f64;
            let (severity, limit) = match share {
                s if s > FAIL_ABOVE => (Severity::Fail, FAIL_ABOVE),
                s if s > CAUTION_ABOVE => (Severity::Caution, CAUTION_ABOVE),
                _ => return None,
            };
            let (worst_share, worst_idx) = worst?;
            let worst_view = case.view_name(case.dataset.views.get(worst_idx)?);
            Some(Found {
                severity,
                place: name.to_owned(),
                message: format!(
                    "{n_outliers} of {n_all} corners ({:.1} %) were rejected as outliers; worst is {worst_view} \
                     with {:.0} %",
                    100.0 * share,
                    100.0 * worst_share
                ),
                measured: Some(share),
                limit: Some(limit),
                fix: format!("Look at {worst_view} for blur, motion or wrong corners, and remove it if it is bad."),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let with = |n_of_each: usize| {
            let mut example = Example::mono();
            for view_idx in 0..example.dataset.views.len() {
                let n = example.dataset.views[view_idx].observations.len();
                example.reject(view_idx, n * n_of_each / 100);
            }
            example
        };
        vec![(with(10), Severity::Caution), (with(30), Severity::Fail)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_view_is_named() {
        let mut example = Example::stereo();
        example.dataset.views[4].image = Some("left07.jpg".to_owned());
        for view_idx in [2, 4, 6, 8] {
            let n = example.dataset.views[view_idx].observations.len();
            example.reject(view_idx, if view_idx == 4 { n } else { n / 2 });
        }
        let camera = example.dataset.views[4].camera;
        let found = ManyRejected::find(&Case::new(&example.dataset, &example.calibration));
        let of_camera = found.iter().find(|f| f.place == example.dataset.cameras[camera].name).unwrap();
        assert!(of_camera.message.ends_with("worst is left07.jpg with 100 %"), "{}", of_camera.message);
    }

    #[test]
    fn views_left_out_are_not_outliers() {
        let mut example = Example::mono();
        (0..10).for_each(|view_idx| example.leave_out(view_idx, "the pose is ambiguous"));
        assert!(ManyRejected::find(&Case::new(&example.dataset, &example.calibration)).is_empty());
    }
}
