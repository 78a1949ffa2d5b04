//! Rig and target on a robot, and how far its clock is from the camera's.

use boresight_data::Mounting;
use boresight_geometry::nalgebra::{DVector, Matrix6xX};
use boresight_geometry::{Pose, PoseStream, Vector6};

use super::PoseModel;

/// What a robot said of its flange.
#[derive(Clone, Debug, PartialEq)]
pub enum Arm {
    /// `base_from_flange` of each row.
    Rows(Vec<Pose>),
    /// `base_from_flange` over the robot's time, and the camera's time of each row.
    Stream {
        /// What the robot said.
        base_from_flange: PoseStream,
        /// The time of each row by the camera's clock, in seconds.
        times_s: Vec<f64>,
    },
}

/// Where rig and target sit on a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeModel {
    /// What the robot said.
    pub arm: Arm,
    /// Which of rig and target moves.
    pub mounting: Mounting,
    /// The rig on its carrier.
    pub carrier_from_rig: Pose,
    /// The target on the other of flange and base.
    pub other_from_target: Pose,
    /// What the robot's clock shows when the camera's shows zero, in seconds; of no meaning without times.
    pub offset_s: f64,
}

impl HandEyeModel {
    /// Returns `base_from_flange` of a row, and its twist per second where it moves.
    fn told(&self, row: usize) -> Option<(Pose, Option<Vector6<f64>>)> {
        match &self.arm {
            Arm::Rows(poses) => Some((*poses.get(row)?, None)),
            Arm::Stream { base_from_flange, times_s } => {
                let time_s = times_s.get(row)? + self.offset_s;
                Some((base_from_flange.at(time_s)?, Some(base_from_flange.twist(time_s)?)))
            }
        }
    }
}

impl PoseModel for HandEyeModel {
    fn columns(&self) -> usize {
        match self.arm {
            Arm::Rows(_) => 12,
            Arm::Stream { .. } => 13,
        }
    }

    fn pose(&self, row: usize) -> Option<Pose> {
        let (base_from_flange, _) = self.told(row)?;
        let carrier_from_other = match self.mounting {
            Mounting::RigOnFlange => base_from_flange.inverse(),
            Mounting::RigInBase => base_from_flange,
        };
        Some(self.carrier_from_rig.inverse() * carrier_from_other * self.other_from_target)
    }

    fn predicted(&self, row: usize) -> Option<(Pose, Matrix6xX<f64>)> {
        let (base_from_flange, twist) = self.told(row)?;
        let carrier_from_other = match self.mounting {
            Mounting::RigOnFlange => base_from_flange.inverse(),
            Mounting::RigInBase => base_from_flange,
        };
        let rig_from_carrier = self.carrier_from_rig.inverse();
        let rig_from_other = rig_from_carrier * carrier_from_other;
        let mut by_unknowns = Matrix6xX::zeros(self.columns());
        by_unknowns.view_mut((0, 0), (6, 6)).copy_from(&-rig_from_carrier.adjoint());
        by_unknowns.view_mut((0, 6), (6, 6)).copy_from(&rig_from_other.adjoint());
        if let Some(twist) = twist {
            // The flange moves in the base by the twist, the base in the flange's frame by its opposite.
            let column = match self.mounting {
                Mounting::RigOnFlange => -(rig_from_other.adjoint() * twist),
                Mounting::RigInBase => rig_from_carrier.adjoint() * twist,
            };
            by_unknowns.view_mut((0, 12), (6, 1)).copy_from(&column);
        }
        Some((rig_from_other * self.other_from_target, by_unknowns))
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let tangent = |first: usize| Vector6::from_iterator(step.iter().skip(first).take(6).copied());
        Self {
            carrier_from_rig: self.carrier_from_rig.perturbed(&tangent(0)),
            other_from_target: self.other_from_target.perturbed(&tangent(6)),
            offset_s: self.offset_s + step.get(12).copied().unwrap_or(0.0),
            ..self.clone()
        }
    }
}
