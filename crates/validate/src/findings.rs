//! What is doubtful about a calibration, found in its data and result.
//!
//! A finding is a plug: a file that implements [`Diagnostic`], and one line in `registry.rs`. The
//! registry's tests hold each to the same: a kebab-case code of its own, a long text, an example on
//! which it fires, and silence on good data.
//!
//! Limits are constants at the top of each file. They are rules of thumb of the field, not
//! estimates: a finding says what was measured and what it was held against, so that a reader can judge.

mod bad_view;
mod biased_residuals;
mod blurred_images;
mod bow;
mod case;
mod coverage;
mod duplicate_points;
#[cfg(test)]
mod example;
mod few_views;
mod held_out;
mod large_rms;
mod left_out;
mod little_tilt;
mod loose_knots;
mod many_rejected;
mod mirrored_corners;
mod near_identical_frames;
mod no_covariance;
mod not_converged;
mod not_monotonic;
mod not_separable;
mod registry;
mod regularization_pull;
mod small_board;
mod uncertain_focal;
mod understated_sigmas;
mod unseen_rim;
mod weak_rig_link;

use boresight_data::{Calibration, Dataset, Finding, Severity};

pub(crate) use blurred_images::middle_sigma_px;
pub(crate) use case::Case;
pub(crate) use coverage::coverage;
pub(crate) use little_tilt::spread_of_normals as tilt_spread_rad;
pub(crate) use small_board::largest_board;
pub(crate) use weak_rig_link::weakest_link;

/// A kind of finding.
trait Diagnostic {
    /// The stable code: what `boresight explain` takes.
    const CODE: &'static str;

    /// What it means, why it matters and how to fix it: a few paragraphs for a person who reads it
    /// for the first time.
    const EXPLANATION: &'static str;

    /// Returns all that is found, in any order.
    fn find(case: &Case) -> Vec<Found>;

    /// Returns cases on which it fires, with the gravest severity it then has.
    #[cfg(test)]
    fn examples() -> Vec<(example::Example, Severity)>;
}

/// A finding without its code.
#[derive(Clone, Debug)]
struct Found {
    severity: Severity,
    place: String,
    message: String,
    measured: Option<f64>,
    limit: Option<f64>,
    fix: String,
}

/// Returns what is doubtful about `calibration`, which was made from `dataset`: gravest first, then
/// by code and place.
pub fn findings(dataset: &Dataset, calibration: &Calibration) -> Vec<Finding> {
    sorted(registry::find_all(&Case::new(dataset, calibration)))
}

/// Returns what is doubtful about `dataset` before any solve, in the order of [`findings`]. `start` holds what a start
/// can tell: lenses and poses, with residuals for each view that it could use.
pub fn findings_before(dataset: &Dataset, start: &Calibration) -> Vec<Finding> {
    sorted(registry::find_before(&Case::new(dataset, start)))
}

fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(|one, other| {
        let key = |finding: &Finding| (std::cmp::Reverse(finding.severity), finding.code.clone());
        (key(one).cmp(&key(other)))
            .then_with(|| (&one.place, &one.message).cmp(&(&other.place, &other.message)))
    });
    findings
}

/// Returns the long text of a code: what it means, why it matters, how to fix it. `None` for an unknown code.
pub fn explain(code: &str) -> Option<&'static str> {
    registry::ALL.iter().find(|(known, _)| *known == code).map(|(_, explanation)| *explanation)
}

/// Returns all codes in alphabetical order.
pub fn codes() -> Vec<&'static str> {
    let mut codes: Vec<&str> = registry::ALL.iter().map(|(code, _)| *code).collect();
    codes.sort_unstable();
    codes
}

/// Returns a count with its noun, such as `1 view` and `3 views`.
fn count(n: usize, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

#[cfg(test)]
mod tests {
    use super::example::Example;
    use super::*;

    #[test]
    fn the_gravest_comes_first_and_order_is_fixed() {
        let mut example = Example::stereo();
        example.calibration.solve.converged = false;
        example.calibration.scene.targets.iter_mut().for_each(|target| target.shape_m = vec![0.0, 0.002]);
        example.calibration.uncertainty.covariance.iter_mut().for_each(|entry| *entry *= 1e4);
        let found = findings(&example.dataset, &example.calibration);
        let keys: Vec<_> = found.iter().map(|f| (f.severity, f.code.as_str(), f.place.as_str())).collect();
        let expected = [
            (Severity::Fail, "not-converged", "solve"),
            (Severity::Fail, "uncertain-focal", "cam0"),
            (Severity::Fail, "uncertain-focal", "cam1"),
            (Severity::Note, "bow", "board"),
        ];
        assert_eq!(keys, expected);
        assert_eq!(found, findings(&example.dataset, &example.calibration));
    }

    #[test]
    fn mismatched_data_do_not_panic() {
        let example = Example::stereo();
        let other = Example::mono();
        for (dataset, calibration) in [
            (&example.dataset, &other.calibration),
            (&other.dataset, &example.calibration),
            (&Dataset::default(), &example.calibration),
        ] {
            findings(dataset, calibration);
        }
    }

    #[test]
    fn codes_are_explained() {
        assert!(codes().len() >= 16 && codes().is_sorted());
        assert!(codes().iter().all(|code| explain(code).is_some()));
        assert_eq!(explain("E201"), None);
    }
}
