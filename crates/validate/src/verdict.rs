//! All findings in one word.

use std::fmt;

use boresight_data::{Finding, Severity};
use serde::{Deserialize, Serialize};

/// Whether a calibration is fit for use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing speaks against it.
    Good,
    /// It may be worse than it looks; the findings say how to tell.
    Caution,
    /// It should not be used as it is.
    Fail,
}

/// Returns the verdict of the gravest finding; notes do not count.
pub fn verdict(findings: &[Finding]) -> Verdict {
    match findings.iter().map(|finding| finding.severity).max() {
        None | Some(Severity::Note) => Verdict::Good,
        Some(Severity::Caution) => Verdict::Caution,
        Some(Severity::Fail) => Verdict::Fail,
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Verdict::Good => "good",
            Verdict::Caution => "caution",
            Verdict::Fail => "fail",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(severities: &[Severity], expected: Verdict) {
        let finding = |&severity| Finding {
            code: "x".to_owned(),
            severity,
            place: "y".to_owned(),
            message: String::new(),
            measured: None,
            limit: None,
            fix: String::new(),
        };
        let findings: Vec<Finding> = severities.iter().map(finding).collect();
        assert_eq!(verdict(&findings), expected);
    }

    #[test]
    fn the_gravest_finding_decides() {
        check(&[], Verdict::Good);
        check(&[Severity::Note, Severity::Note], Verdict::Good);
        check(&[Severity::Note, Severity::Caution], Verdict::Caution);
        check(&[Severity::Fail, Severity::Caution, Severity::Note], Verdict::Fail);
    }

    #[test]
    fn words_are_the_same_everywhere() {
        for verdict in [Verdict::Good, Verdict::Caution, Verdict::Fail] {
            assert_eq!(serde_json::to_string(&verdict).unwrap(), format!("\"{verdict}\""));
        }
    }
}
