//! The layout of `calibration.json`, schema `boresight.calibration/1`.

use std::collections::BTreeMap;

use boresight_data::{Finding, HeldOut, LooseDirection, Provenance};
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The whole file.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Document {
    pub schema: String,
    /// OpenCV's RMS over all kept observations, in pixels.
    pub rms_px: Number,
    pub stop: String,
    pub cameras: Vec<CameraDocument>,
    /// The first target's shape, for readers that want no more.
    #[serde(skip_deserializing, default)]
    pub target: TargetSummary,
    pub targets: Vec<TargetDocument>,
    pub baselines_m: BTreeMap<String, Estimate>,
    pub noise_factor: Number,
    pub degrees_of_freedom: usize,
    pub regularization: RegularizationDocument,
    pub solve: SolveDocument,
    pub frames: Vec<FrameDocument>,
    pub views: Vec<ViewDocument>,
    pub rejected: Vec<RejectionDocument>,
    pub robot: Option<RobotDocument>,
    /// Absent in files of before it was worked out, and null where it was not.
    #[serde(default)]
    pub held_out: Option<HeldOut>,
    pub covariance: CovarianceDocument,
    #[serde(default)]
    pub findings: Vec<Finding>,
    pub provenance: Provenance,
}

/// A camera; what is null could not be calibrated.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct CameraDocument {
    pub name: String,
    pub model: Option<String>,
    pub image_size: Option<[u32; 2]>,
    pub params: Option<Params>,
    pub cam_from_rig: Option<PoseDocument>,
    /// How much later than a frame's time its images were taken, where that was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_offset_s: Option<Param>,
    /// How much later than the row above it each row of its images was taken, where that was estimated or stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line_delay_s: Option<Param>,
    pub rms_px: Number,
    pub views: usize,
    pub observations: usize,
    pub rejected: usize,
}

/// Named parameters in the order of the lens model.
#[derive(Debug)]
pub(crate) struct Params(pub Vec<(String, Param)>);

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Param {
    pub value: f64,
    /// The standard deviation; null where `why` says.
    #[serde(skip_deserializing, default)]
    pub sigma: Option<f64>,
    #[serde(skip_deserializing, default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// A number with its standard deviation.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Estimate {
    pub value: Number,
    pub sigma: Number,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct PoseDocument {
    pub rotation_xyzw: [f64; 4],
    pub translation_m: [f64; 3],
    /// Of a rotation by the left, about the axes of the frame the pose leads to.
    #[serde(skip_deserializing, default, skip_serializing_if = "Option::is_none")]
    pub rotation_sigma_rad: Option<[f64; 3]>,
    #[serde(skip_deserializing, default, skip_serializing_if = "Option::is_none")]
    pub translation_sigma_m: Option<[f64; 3]>,
}

#[derive(Debug, Default, Serialize)]
pub(crate) struct TargetSummary {
    pub name: String,
    /// The shape coefficients in metres.
    pub shape: Vec<f64>,
    pub shape_sigma_m: Option<Vec<f64>>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct TargetDocument {
    pub name: String,
    pub geometry: GeometryDocument,
    pub shape: ShapeDocument,
    pub shape_m: Vec<f64>,
    pub first_from_target: PoseDocument,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub(crate) enum GeometryDocument {
    Chessboard { columns: u32, rows: u32, spacing_m: f64 },
    Charuco { columns: u32, rows: u32, spacing_m: f64, marker_m: f64, dictionary: String },
    AprilGrid { columns: u32, rows: u32, tag_m: f64, spacing: f64, dictionary: String },
    Circles { columns: u32, rows: u32, spacing_m: f64, layout: LayoutDocument },
    Points { points_m: Vec<[f64; 3]> },
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LayoutDocument {
    Symmetric,
    Asymmetric,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ShapeDocument {
    Rigid,
    Parabolic2,
    Twisted6,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct RegularizationDocument {
    pub kind: String,
    pub rows: usize,
    pub chi2: Number,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct SolveDocument {
    pub chi2: Number,
    pub iterations: usize,
    pub evaluations: usize,
    pub passes: usize,
    pub converged: bool,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct FrameDocument {
    pub name: String,
    pub rig_from_target: Option<PoseDocument>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<MotionDocument>,
}

/// How a target moved in a frame: tangents, rotation in radians and translation in metres, by time in seconds.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct MotionDocument {
    pub velocity_per_s: [f64; 6],
    pub acceleration_per_s2: [f64; 6],
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ViewDocument {
    pub rms_px: Option<Number>,
    /// The number of residuals, which are in the parquet.
    #[serde(default)]
    pub observations: usize,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct RejectionDocument {
    pub view: usize,
    pub point: u32,
    pub reason: ReasonDocument,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub(crate) enum ReasonDocument {
    Outlier { sigmas: Number, limit: Number },
    LeftOut { why: String },
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct RobotDocument {
    pub mount: MountDocument,
    pub target_mount: TargetMountDocument,
    pub tip_in_flange_m: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stretch: Option<StretchDocument>,
}

/// How a robot's positions are off: `position + matrix * (position - centre)`, the matrix row by row.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct StretchDocument {
    pub centre_in_base_m: [f64; 3],
    pub matrix: [[f64; 3]; 3],
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum MountDocument {
    OnFlange { flange_from_rig: PoseDocument },
    Fixed { base_from_rig: PoseDocument },
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum TargetMountDocument {
    Fixed { base_from_target: PoseDocument },
    OnFlange { flange_from_target: PoseDocument },
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct CovarianceDocument {
    pub names: Vec<String>,
    pub rows: Vec<Vec<f64>>,
    pub unavailable: Option<String>,
    /// By name, in their order; empty in files of before it was written.
    #[serde(default)]
    pub regularization_information: Vec<f64>,
    /// Two places among the names and an entry; only there where regularisation ties parameters together.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub regularization_pairs: Vec<(usize, usize, f64)>,
    #[serde(default)]
    pub motions: MotionsDocument,
    #[serde(default)]
    pub loose: Vec<LooseDirection>,
}

/// Motions of all frames together; a row has the covariances with the parameters, then with the motions.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct MotionsDocument {
    pub names: Vec<String>,
    pub rows: Vec<Vec<f64>>,
}

/// A number that may have none: one that is not finite is written as null with the reason.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Number {
    Finite(f64),
    Not { value: (), reason: String },
}

impl From<f64> for Number {
    fn from(value: f64) -> Self {
        if value.is_finite() {
            Number::Finite(value)
        } else {
            Number::Not { value: (), reason: value.to_string() }
        }
    }
}

impl From<&Number> for f64 {
    fn from(number: &Number) -> f64 {
        match number {
            Number::Finite(value) => *value,
            Number::Not { reason, .. } => reason.parse().unwrap_or(f64::NAN),
        }
    }
}

impl Serialize for Params {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, param)| (name, param)))
    }
}

impl<'de> Deserialize<'de> for Params {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder;
        impl<'de> Visitor<'de> for InOrder {
            type Value = Params;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("parameters by name, each with a value")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Params, A::Error> {
                let mut params = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    params.push(entry);
                }
                Ok(Params(params))
            }
        }
        deserializer.deserialize_map(InOrder)
    }
}
