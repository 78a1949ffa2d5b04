//! The registry of findings: one line each.

use boresight_data::Finding;

use super::case::Case;
use super::{Diagnostic, Found};

macro_rules! diagnostics {
    (
        at any time: $($any:ty),* $(,)?;
        before a solve: $($before:ty),* $(,)?;
        after a solve: $($after:ty),* $(,)?;
    ) => {
        /// Each code with its long text.
        pub(super) const ALL: &[(&str, &str)] =
            &[
                $((<$any as Diagnostic>::CODE, <$any as Diagnostic>::EXPLANATION),)*
                $((<$before as Diagnostic>::CODE, <$before as Diagnostic>::EXPLANATION),)*
                $((<$after as Diagnostic>::CODE, <$after as Diagnostic>::EXPLANATION),)*
            ];

        /// Returns the findings about a result.
        pub(super) fn find_all(case: &Case) -> Vec<Finding> {
            let mut findings = Vec::new();
            $(findings.extend(find::<$any>(case));)*
            $(findings.extend(find::<$after>(case));)*
            findings
        }

        /// Returns the findings about data of which there is no more than a start.
        pub(super) fn find_before(case: &Case) -> Vec<Finding> {
            let mut findings = Vec::new();
            $(findings.extend(find::<$any>(case));)*
            $(findings.extend(find::<$before>(case));)*
            findings
        }

        #[cfg(test)]
        fn check_each() {
            $(tests::check::<$any>();)*
            $(tests::check::<$before>();)*
            $(tests::check::<$after>();)*
        }
    };
}

diagnostics! {
    at any time:
    super::coverage::Coverage,
    super::duplicate_points::DuplicatePoints,
    super::few_views::FewViews,
    super::left_out::LeftOut,
    super::little_tilt::LittleTilt,
    super::near_identical_frames::NearIdenticalFrames,
    super::unseen_rim::UnseenRim,
    super::weak_rig_link::WeakRigLink;
    before a solve:
    super::blurred_images::BlurredImages,
    super::mirrored_corners::MirroredCorners,
    super::small_board::SmallBoard;
    after a solve:
    super::bad_view::BadView,
    super::biased_residuals::BiasedResiduals,
    super::bow::Bow,
    super::held_out::HeldOut,
    super::large_rms::LargeRms,
    super::loose_knots::LooseKnots,
    super::many_rejected::ManyRejected,
    super::no_covariance::NoCovariance,
    super::not_converged::NotConverged,
    super::not_monotonic::NotMonotonic,
    super::not_separable::NotSeparable,
    super::regularization_pull::RegularizationPull,
    super::uncertain_focal::UncertainFocal,
    super::understated_sigmas::UnderstatedSigmas;
}

fn find<D: Diagnostic>(case: &Case) -> impl Iterator<Item = Finding> {
    D::find(case).into_iter().map(|Found { severity, place, message, measured, limit, fix }| Finding {
        code: D::CODE.to_owned(),
        severity,
        place,
        message,
        measured,
        limit,
        fix,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::example::Example;
    use super::*;

    /// Holds a kind of finding to what all of them promise.
    pub(super) fn check<D: Diagnostic>() {
        let code = D::CODE;
        assert!(
            code.chars().all(|c| c.is_ascii_lowercase() || c == '-')
                && code.split('-').all(|word| !word.is_empty()),
            "{code} is not kebab-case"
        );
        let text = D::EXPLANATION;
        assert!(text.len() >= 400, "{code}: an explanation of {} characters explains little", text.len());
        for heading in ["What it means: ", "Why it matters: ", "How to fix it: "] {
            assert_eq!(text.matches(heading).count(), 1, "{code}: `{heading}` is missing or repeated");
        }
        assert!(text.ends_with('.'), "{code}");
        assert!(text.lines().all(|line| line.len() <= 80), "{code}: lines are too long for a terminal");

        for good in [Example::mono(), Example::stereo(), Example::fisheye()] {
            let found = D::find(&Case::new(&good.dataset, &good.calibration));
            assert!(found.is_empty(), "{code} is found in good data: {found:?}");
        }
        let examples = D::examples();
        assert!(!examples.is_empty(), "{code} has no example");
        for (i, (example, gravest)) in examples.iter().enumerate() {
            let found = D::find(&Case::new(&example.dataset, &example.calibration));
            let severity = found.iter().map(|found| found.severity).max();
            assert_eq!(severity, Some(*gravest), "{code}, example {i}: {found:?}");
            for found in found {
                assert!(!found.place.is_empty() && found.message.len() > 20, "{code}: {found:?}");
                assert!(found.fix.len() > 20 && found.fix.ends_with('.'), "{code}: {found:?}");
                assert!(!found.message.ends_with('.'), "{code}: {found:?}");
            }
        }
    }

    #[test]
    fn all_kinds_keep_their_promises() {
        check_each();
    }

    #[test]
    fn codes_are_unique() {
        let codes: BTreeSet<&str> = ALL.iter().map(|(code, _)| *code).collect();
        assert_eq!(codes.len(), ALL.len());
    }

    #[test]
    fn every_file_is_registered() {
        // A code is the file's name; the file list is the folder's, at the time of the test.
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/findings");
        let helpers = ["case", "example", "registry"];
        let files: BTreeSet<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().replace('_', "-"))
            .filter(|stem| !helpers.contains(&stem.as_str()))
            .collect();
        let codes: BTreeSet<String> = ALL.iter().map(|(code, _)| (*code).to_owned()).collect();
        assert_eq!(files, codes);
    }
}
