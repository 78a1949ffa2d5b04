//! Findings: what was noticed about data or result, with the number and the fix.

use serde::{Deserialize, Serialize};

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Worth knowing.
    Note,
    /// The result may be worse than it looks.
    Caution,
    /// The result should not be used as it is.
    Fail,
}

/// Something noticed, with what was measured, what the limit is, and what to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// A stable code such as `few-views`.
    pub code: String,
    /// How much it matters.
    pub severity: Severity,
    /// The file, camera, frame or parameter it is about.
    pub place: String,
    /// What was noticed, in a sentence.
    pub message: String,
    /// The measured value, where there is one.
    pub measured: Option<f64>,
    /// The limit it was held against, where there is one.
    pub limit: Option<f64>,
    /// What to do about it.
    pub fix: String,
}
