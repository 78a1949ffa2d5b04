//! `boresight robot`: the robot side of a camera. A subcommand is a file in the folder `robot` and one
//! line in each of the lists here.

mod locate;
mod plane;
mod pose;

mod hand_eye;
mod planar;
mod poses;
mod sighted_poses;

use std::process::ExitCode;

use clap::Subcommand;

use crate::failure::Failure;

/// What can be done for a robot.
#[derive(Debug, Subcommand)]
pub(crate) enum RobotCommand {
    /// Find all poses of an object from three or more of its points in one image (Eqs 8.15, 8.16)
    Locate(locate::LocateArguments),
    /// Relate the image to the robot's plane by touched points (Eqs 8.23 to 8.27)
    Plane(plane::PlaneArguments),
    /// Find objects in the robot's frame from one image, by a plane (Eqs 8.28 to 8.30)
    Pose(pose::PoseArguments),
    /// Calibrate where cameras and target sit on a robot, with the lenses, in one adjustment
    HandEye(hand_eye::HandEyeArguments),
    /// Calibrate wheels, axle and sensor of a robot that moves in the plane
    Planar(planar::PlanarArguments),
    /// Try all conventions of a table of robot poses on the data, and rank them
    Poses(poses::PosesArguments),
}

/// Runs a subcommand.
pub(crate) fn run(command: &RobotCommand) -> Result<ExitCode, Failure> {
    match command {
        RobotCommand::Locate(arguments) => locate::run(arguments),
        RobotCommand::Plane(arguments) => plane::run(arguments),
        RobotCommand::Pose(arguments) => pose::run(arguments),
        RobotCommand::HandEye(arguments) => hand_eye::run(arguments),
        RobotCommand::Planar(arguments) => planar::run(arguments),
        RobotCommand::Poses(arguments) => poses::run(arguments),
    }
}
