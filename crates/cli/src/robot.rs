//! `boresight robot`: the robot side of a camera. A subcommand is a file in the folder `robot` and one
//! line in each of the two lists here.

mod hand_eye;
mod planar;
mod poses;

use std::process::ExitCode;

use clap::Subcommand;

use crate::failure::Failure;

/// What can be done for a robot.
#[derive(Debug, Subcommand)]
pub(crate) enum RobotCommand {
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
        RobotCommand::HandEye(arguments) => hand_eye::run(arguments),
        RobotCommand::Planar(arguments) => planar::run(arguments),
        RobotCommand::Poses(arguments) => poses::run(arguments),
    }
}
