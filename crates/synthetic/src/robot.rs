//! A robot that held the rig, or the target, wherever a simulation put it.

use boresight_data::{Mounting, Robot};
use boresight_geometry::{Pose, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::simulate::Synthetic;

/// A robot, where rig and target sit on it, and how far its readings are off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotRecipe {
    /// Which of rig and target moves.
    pub mounting: Mounting,
    /// The rig's pose on the flange or in the base.
    pub carrier_from_rig: Pose,
    /// The target's pose in the base or on the flange.
    pub other_from_target: Pose,
    /// The standard deviation of the rotation about each axis, in radians. Zero is off.
    pub rotation_rad: f64,
    /// The standard deviation of the position along each axis, in metres. Zero is off.
    pub translation_m: f64,
}

impl RobotRecipe {
    /// Returns a camera on the flange that looks at a board on a table, and an exact robot.
    pub fn on_flange() -> Self {
        Self {
            mounting: Mounting::RigOnFlange,
            carrier_from_rig: Pose::from_rodrigues(
                Vector3::new(0.05, -0.03, 1.5),
                Vector3::new(0.06, -0.03, 0.08),
            ),
            other_from_target: Pose::from_rodrigues(
                Vector3::new(3.1, 0.05, -0.1),
                Vector3::new(0.9, 0.2, 0.05),
            ),
            rotation_rad: 0.0,
            translation_m: 0.0,
        }
    }

    /// Returns a camera in the work cell that looks at a board on the flange, and an exact robot.
    pub fn fixed() -> Self {
        Self {
            mounting: Mounting::RigInBase,
            carrier_from_rig: Pose::from_rodrigues(
                Vector3::new(-1.5, 0.3, -0.2),
                Vector3::new(1.6, 0.3, 0.7),
            ),
            other_from_target: Pose::from_rodrigues(
                Vector3::new(0.1, 0.2, -0.6),
                Vector3::new(-0.1, 0.05, 0.04),
            ),
            ..Self::on_flange()
        }
    }
}

/// Puts a robot under a simulation: its truth gets the robot, its frames get what the robot said of its flange.
pub fn add_robot(made: &mut Synthetic, recipe: &RobotRecipe, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for (frame, rig_from_target) in made.dataset.frames.iter_mut().zip(&made.truth.rig_from_target) {
        let mut normal = |sigma: f64| {
            let axes: [f64; 3] = std::array::from_fn(|_| rng.sample(StandardNormal));
            Vector3::from(axes) * sigma
        };
        let (turn, shift) = (normal(recipe.rotation_rad), normal(recipe.translation_m));
        frame.base_from_flange = rig_from_target.map(|rig_from_target| {
            let carrier_from_other =
                recipe.carrier_from_rig * rig_from_target * recipe.other_from_target.inverse();
            let base_from_flange = match recipe.mounting {
                Mounting::RigOnFlange => carrier_from_other.inverse(),
                Mounting::RigInBase => carrier_from_other,
            };
            let turn = Pose::from_rodrigues(turn, Vector3::zeros());
            Pose::new(turn.rotation * base_from_flange.rotation, base_from_flange.translation + shift)
        });
    }
    made.truth.robot =
        Some(Robot::mounted(recipe.mounting, recipe.carrier_from_rig, recipe.other_from_target));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Recipe, simulate};

    #[test]
    fn an_exact_robot_explains_every_frame() {
        for recipe in [RobotRecipe::on_flange(), RobotRecipe::fixed()] {
            let mut made = simulate(&Recipe::mono(), 1);
            add_robot(&mut made, &recipe, 2);
            let robot = made.truth.robot.as_ref().unwrap();
            for (frame, rig_from_target) in made.dataset.frames.iter().zip(&made.truth.rig_from_target) {
                let foretold = robot.rig_from_target(&frame.base_from_flange.unwrap());
                let error = (foretold * rig_from_target.unwrap().inverse()).log().norm();
                assert!(error < 1e-12, "{error}");
            }
        }
    }
}
