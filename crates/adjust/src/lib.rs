//! From a dataset and a seed to a solver problem, and from its solution to a calibration.
//!
//! One residual block serves every topology: a view is a lens, a target shape and a chain of poses
//! from target to camera, and which of them are shared is data.
//!
//! Architecture invariant: nothing here knows how a dataset came about or what becomes of a calibration.

mod adjust;
mod chain;
mod error;
mod leave_one_out;
mod loose;
mod motions;
mod object_pose;
mod options;
mod pose_fit;
mod regularization;
mod rejection;
mod report;
mod reprojection;
mod rig_problem;
mod robot;
mod robot_noise;
mod robot_touch;
mod sighted_point;
mod stand_in;
mod suspects;
#[cfg(test)]
mod test_numbers;
mod time_offset;
mod touch;

pub use adjust::{Optimum, Settled, adjust, optimize, settle};
pub use chain::{Chain, Link, clock};
pub use error::Error;
pub use leave_one_out::{HeldOut, SightErrors, leave_one_out, sight_errors};
pub use object_pose::{ObjectPose, ObjectPoseError, SeenPoint, assessed, object_pose};
pub use options::{
    AdjustOptions, Clock, Hold, Loss, Observer, Prior, Progress, Quantity, Regularization, Rejection,
    RobotNoise, Share,
};
pub use pose_fit::{Arm, HandEyeModel, JointModel, PoseFit, PoseFitError, PoseModel, PoseNoise};
pub use regularization::mrcal22_rows;
pub use reprojection::{Layouts, Reprojection, TargetPoints};
pub use robot_noise::{EstimatedNoise, estimate_robot_noise};
pub use robot_touch::{RobotTouch, RobotTouches};
pub use sighted_point::{Sight, SightedPoint, SightedPointError, sighted_point};
pub use time_offset::{
    LEAST_FRAMES, LOOSEST_READOUT_S, LineDelay, TimeOffset, TimeSearch, Timed, adjust_times, views_in_motion,
};
pub use touch::{
    Heights, PlaneFunction, Position, TipKnowledge, Touch, TouchError, TouchFit, TouchLens, TouchOptions,
    TouchedPlane, TriedModel, contradiction, plane_columns, plane_position, plane_spread, touched_plane,
};
