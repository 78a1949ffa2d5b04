//! What was seen: cameras, targets, frames, and the views that tie them together.

use boresight_geometry::Pose;

use crate::{CameraId, FrameId, IdVec, PointId, Target, TargetId};

/// Everything that was measured. It is never mutated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dataset {
    /// The cameras that looked.
    pub cameras: IdVec<CameraId, CameraInfo>,
    /// The targets that were looked at.
    pub targets: IdVec<TargetId, Target>,
    /// The instants of looking.
    pub frames: IdVec<FrameId, Frame>,
    /// What each camera saw of each target at each instant, ordered by frame, then camera, then target.
    pub views: Vec<View>,
}

/// What is known of a camera before calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// The name, unique in a dataset.
    pub name: String,
    /// Width and height of the image in pixels.
    pub image_size: [u32; 2],
}

/// An instant at which all cameras looked at once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// The name, unique in a dataset.
    pub name: String,
    /// The time of exposure, where known.
    pub time_ns: Option<i64>,
    /// Where the robot said its flange was, where there is a robot.
    pub base_from_flange: Option<Pose>,
}

/// What one camera saw of one target in one frame: the unit that is detected, weighed, plotted and solved.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: CameraId,
    /// The instant.
    pub frame: FrameId,
    /// The target.
    pub target: TargetId,
    /// The image it was detected in, as the input named it.
    pub image: Option<String>,
    /// The points seen, in increasing order of their ids, each at most once.
    pub observations: Vec<Observation>,
}

/// A point of a target, seen at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The point.
    pub point: PointId,
    /// Where it was seen; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f64; 2],
    /// The standard deviation of either pixel coordinate.
    pub sigma_px: f64,
}

impl Dataset {
    /// Returns the number of observations in all views.
    pub fn observation_count(&self) -> usize {
        self.views.iter().map(|view| view.observations.len()).sum()
    }
}
