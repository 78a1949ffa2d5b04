//! Rig and target on a robot, and how far its clock is from the camera's.

use std::sync::Arc;

use boresight_data::Mounting;
use boresight_geometry::nalgebra::{DVector, Matrix6xX};
use boresight_geometry::{Pose, PoseStream, Vector6};

use super::{PoseFit, PoseFitError, PoseModel, fit_poses};

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
    /// What the robot said; shared, for a search makes many models.
    pub arm: Arc<Arm>,
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
    /// Returns where rig and target sit and the offset of the clocks, fitted to the poses that were seen, from this start nearby.
    /// Rows of one block stand together.
    ///
    /// # Panics
    ///
    /// If there are not as many blocks named as poses seen.
    pub fn fitted(self, seen: &[Pose], block_of_row: &[usize]) -> Result<PoseFit<Self>, PoseFitError> {
        fit_poses(self, seen, block_of_row)
    }

    /// Returns `base_from_flange` of a row.
    fn told(&self, row: usize) -> Option<Pose> {
        match &*self.arm {
            Arm::Rows(poses) => poses.get(row).copied(),
            Arm::Stream { base_from_flange, times_s } => {
                base_from_flange.at(times_s.get(row)? + self.offset_s)
            }
        }
    }

    /// Returns `base_from_flange` of a row, and its twist per second where it moves.
    fn told_moving(&self, row: usize) -> Option<(Pose, Option<Vector6<f64>>)> {
        match &*self.arm {
            Arm::Rows(poses) => Some((*poses.get(row)?, None)),
            Arm::Stream { base_from_flange, times_s } => {
                let (pose, twist) = base_from_flange.at_moving(times_s.get(row)? + self.offset_s)?;
                Some((pose, Some(twist)))
            }
        }
    }
}

impl PoseModel for HandEyeModel {
    fn columns(&self) -> usize {
        match *self.arm {
            Arm::Rows(_) => 12,
            Arm::Stream { .. } => 13,
        }
    }

    fn pose(&self, row: usize) -> Option<Pose> {
        let base_from_flange = self.told(row)?;
        let carrier_from_other = match self.mounting {
            Mounting::RigOnFlange => base_from_flange.inverse(),
            Mounting::RigInBase => base_from_flange,
        };
        Some(self.carrier_from_rig.inverse() * carrier_from_other * self.other_from_target)
    }

    fn predicted(&self, row: usize, by_unknowns: &mut Matrix6xX<f64>) -> Option<Pose> {
        let (base_from_flange, twist) = self.told_moving(row)?;
        let carrier_from_other = match self.mounting {
            Mounting::RigOnFlange => base_from_flange.inverse(),
            Mounting::RigInBase => base_from_flange,
        };
        let rig_from_carrier = self.carrier_from_rig.inverse();
        let rig_from_other = rig_from_carrier * carrier_from_other;
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
        Some(rig_from_other * self.other_from_target)
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
