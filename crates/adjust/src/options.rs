//! What a caller may ask of an adjustment.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use boresight_data::{CameraId, FrameId, TargetId};
use boresight_geometry::Pose;
use boresight_solver::Checkpointing;
pub use boresight_solver::{Observer, Progress};

use crate::robot_touch::RobotTouches;

/// How to adjust.
#[derive(Clone, Debug)]
pub struct AdjustOptions {
    /// What large residuals cost.
    pub loss: Loss,
    /// Which observations are not used.
    pub rejection: Rejection,
    /// What keeps weakly constrained lens parameters in bounds.
    pub regularization: Regularization,
    /// What is held at its seed. Empty estimates all that the data constrain.
    pub holds: Vec<Hold>,
    /// The times of cameras that are estimated; their frames need a motion in the scene. Empty keeps those of the scene.
    pub clocks: Vec<Clock>,
    /// How far the robot's readings are off; `None` takes them as exact.
    pub robot_noise: Option<RobotNoise>,
    /// Points of targets that the robot's tip touched; `None` where there are none. Without a robot in the scene they
    /// tell nothing.
    pub robot_touches: Option<RobotTouches>,
    /// What is believed beforehand, with its covariance.
    pub priors: Vec<Prior>,
    /// What several cameras have in common.
    pub shares: Vec<Share>,
    /// The number of threads; 0 takes one for each core. The result does not depend on it.
    pub threads: usize,
    /// Stop when the model predicts a decrease of chi-squared below this many residual variances.
    pub decrease_below: f64,
    /// The largest number of iterations of one pass.
    pub max_iterations: usize,
    /// Stop a pass after this much time; `None` sets no limit.
    pub time_limit: Option<Duration>,
    /// Stop when this becomes true; `None` cannot be stopped.
    pub cancel: Option<Arc<AtomicBool>>,
    /// Keep the state of the first exact pass in a file and resume from it; `None` does neither.
    pub checkpoint: Option<Checkpointing>,
}

impl Default for AdjustOptions {
    fn default() -> Self {
        Self {
            loss: Loss::None,
            rejection: Rejection::Beyond { sigmas: 4.0 },
            regularization: Regularization::Default,
            holds: Vec::new(),
            clocks: Vec::new(),
            robot_noise: None,
            robot_touches: None,
            priors: Vec::new(),
            shares: Vec::new(),
            threads: 0,
            decrease_below: 1e-6,
            max_iterations: 200,
            time_limit: None,
            cancel: None,
            checkpoint: None,
        }
    }
}

/// A time of a camera that is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Its `time_offset_s`: how late its images are.
    Offset(CameraId),
    /// Its `line_delay_s`: how much later each row is than the one above it.
    LineDelay(CameraId),
}

/// What large residuals cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Loss {
    /// Their square.
    #[default]
    None,
    /// Cauchy's loss `c² ln(1 + s/c²)` of the squared length `s` of a corner's residual.
    Cauchy {
        /// c, in units of the observations' sigma.
        sigmas: f64,
    },
}

/// Which observations are not used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rejection {
    /// All are used.
    None,
    /// Those are not whose residual is longer than this many robust sigmas of its camera.
    /// Each pass judges all observations anew, so a good one comes back.
    Beyond {
        /// The limit on the length of the residual.
        sigmas: f64,
    },
}

/// What keeps weakly constrained lens parameters in bounds. Never part of the noise estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Regularization {
    /// Nothing.
    None,
    /// Rational, thin-prism and tilt coefficients are believed near zero, mildly; others are free.
    #[default]
    Default,
    /// The rows of mrcal up to 2.5.2, whose weight grows with the number of observations.
    Mrcal22,
}

/// The standard deviations of a robot's readings, each axis alike and independent of all others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotNoise {
    /// Of the rotation about each axis, in radians.
    pub rotation_rad: f64,
    /// Of the flange's position along each axis, in metres.
    pub translation_m: f64,
    /// Of each number of the linear map by which all positions are off together, see
    /// [`Stretch`](boresight_data::Stretch); `None` takes them as right on the whole.
    pub stretch: Option<f64>,
}

/// Something that is held at its seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// A lens parameter of a camera, by its index.
    LensParam(CameraId, usize),
    /// All of a camera's lens.
    Lens(CameraId),
    /// Where a camera sits in the rig.
    CamFromRig(CameraId),
    /// Where the target stood in a frame, such as a surveyed board.
    RigFromTarget(FrameId),
    /// The rig's pose on the robot's flange or in its base.
    CarrierFromRig,
    /// The height, along z of the robot's base, of what stands in the base: the target's, or a fixed rig's.
    /// A robot that turns about that axis only cannot tell it.
    BaseHeight,
    /// Where a target stands relative to the first.
    FirstFromTarget(TargetId),
    /// The shapes of all targets.
    Shapes,
}

/// A Gaussian belief from elsewhere, such as an earlier calibration. It never enters the noise estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// What it is about. Each lens parameter, each pose at most once in all priors; one frame's pose at most.
    pub quantities: Vec<Quantity>,
    /// The covariance of the quantities in their order, row by row, where residuals are in units of the stated
    /// sigma of a corner: a calibration's covariance over the square of its noise factor.
    pub covariance: Vec<f64>,
}

/// What a prior is about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quantity {
    /// A lens parameter of a camera, by its index: one column.
    LensParam(CameraId, usize, f64),
    /// Where a camera sits in the rig: six columns of left perturbations. Not of the reference camera.
    CamFromRig(CameraId, Pose),
    /// Where the target stood in a frame, such as a surveyed board: six columns of left perturbations.
    RigFromTarget(FrameId, Pose),
}

/// What several cameras have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Share {
    /// One lens, such as that of a camera that moves and is a camera of the rig at each place.
    Lens(Vec<CameraId>),
}
