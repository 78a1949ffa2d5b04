//! What is believed: lenses, where cameras sit, where targets stood. Seeds, solutions and truths are scenes.

use boresight_camera::Camera;
use boresight_geometry::{Pose, Vector3};

use crate::{CameraId, FrameId, IdVec, TargetId};

/// A complete belief about cameras, targets and their poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// The cameras and where they sit.
    pub rig: Rig,
    /// The robot, where there is one.
    pub robot: Option<Robot>,
    /// The shape and arrangement of the targets.
    pub targets: IdVec<TargetId, TargetBelief>,
    /// Where the first target stood in each frame, seen from the rig; `None` where nothing tells.
    pub rig_from_target: IdVec<FrameId, Option<Pose>>,
}

/// The cameras of a rig. The rig's frame is that of its reference camera, the first one calibrated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    /// Each camera; `None` where it could not be calibrated.
    pub cameras: IdVec<CameraId, Option<RigCamera>>,
}

/// A camera and where it sits in the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// The lens.
    pub camera: Camera,
    /// The camera's pose; the textbook's M with the rig as the reference frame.
    pub cam_from_rig: Pose,
}

/// What is believed of a target beyond its drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetBelief {
    /// The shape coefficients, in metres; none for a rigid target.
    pub shape_m: Vec<f64>,
    /// Where this target stands relative to the first; the identity for the first.
    pub first_from_target: Pose,
}

/// A robot, and how rig and target relate to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Where the rig is mounted.
    pub mount: Mount,
    /// Where the target is mounted.
    pub target_mount: TargetMount,
    /// The touching tip, where one was used.
    pub tip_in_flange: Option<Vector3<f64>>,
}

/// Where the rig is mounted.
#[derive(Clone, Debug, PartialEq)]
pub enum Mount {
    /// On the robot's flange: a mobile camera.
    OnFlange {
        /// The rig's pose on the flange.
        flange_from_rig: Pose,
    },
    /// In the work cell: a fixed camera.
    Fixed {
        /// The rig's pose in the robot's base frame.
        base_from_rig: Pose,
    },
}

/// Where the target is mounted.
#[derive(Clone, Debug, PartialEq)]
pub enum TargetMount {
    /// In the work cell.
    Fixed {
        /// The target's pose in the robot's base frame.
        base_from_target: Pose,
    },
    /// On the robot's flange.
    OnFlange {
        /// The target's pose on the flange.
        flange_from_target: Pose,
    },
}

impl Rig {
    /// Returns the reference camera: the first that is calibrated.
    pub fn reference(&self) -> Option<CameraId> {
        self.cameras.enumerate().find(|(_, camera)| camera.is_some()).map(|(id, _)| id)
    }
}
