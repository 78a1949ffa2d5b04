//! The vocabulary: targets, views, datasets, rigs, scenes, calibrations.
//!
//! [`Dataset`] is what was seen and is never mutated; [`Scene`] is what is believed, whether as a
//! seed, a solution or a truth; [`Calibration`] is a scene together with how good it is and what it
//! came from. Metres, radians, pixels and nanoseconds.
//!
//! Architecture invariant: these are plain values. Nothing here computes a calibration or touches a file.

mod calibration;
mod dataset;
mod dictionary;
mod finding;
mod ids;
mod image;
mod pose_convention;
mod robot_plane;
mod scene;
mod target;

pub use calibration::{
    Calibration, CameraFit, HeldOut, LooseDirection, Motions, Provenance, Regularization, Rejection,
    RejectionReason, SolveRecord, Transfer, Uncertainty, ViewFit,
};
pub use dataset::{CameraInfo, Dataset, Frame, Observation, View};
pub use dictionary::{Dictionary, quarter_turned};
pub use finding::{Finding, Severity};
pub use ids::{CameraId, FrameId, Id, IdVec, PointId, TargetId};
pub use image::{GrayImage, GrayPixels};
pub use pose_convention::{
    AngleUnit, BadPoseConvention, LengthUnit, MAKERS, PoseConvention, PoseDirection, PoseRow, RotationKind,
    TurnsAbout,
};
pub use robot_plane::{PlaneLens, PlaneModel, RobotPlane};
pub use scene::{
    FrameMotion, Mount, Mounting, Rig, RigCamera, Robot, Scene, Stretch, TargetBelief, TargetMount,
};
pub use target::{CircleLayout, Geometry, Shape, Target};
