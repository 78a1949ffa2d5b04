//! A target on a chain of turning joints, seen by a camera that stands: a positioner's kinematics.
//!
//! `rig_from_target(q) = exp(s_1 q_1) ... exp(s_n q_n) rig_from_target(0)`: Brockett's product of exponentials
//! (1984). A joint is the line about which it turns, four numbers in the rig's frame; the pose at the reference
//! takes six. Nothing else can be told, and nothing is counted twice, however the joints are arranged.

use std::sync::Arc;

use boresight_geometry::nalgebra::{DVector, Matrix6xX};
use boresight_geometry::{Matrix6, Pose, Vector3, Vector6};

use super::{PoseFit, PoseFitError, PoseModel, fit_poses};

/// A chain of turning joints.
#[derive(Clone, Debug, PartialEq)]
pub struct JointModel {
    /// The joints' angles of each row, in radians, relative to the reference.
    pub angles_rad: Arc<Vec<Vec<f64>>>,
    /// The lines about which joints turn, the one nearest to the camera first: the z axes of these frames, where
    /// all joints are at the reference.
    pub rig_from_joint: Vec<Pose>,
    /// Where the target is at the reference.
    pub rig_from_target: Pose,
}

/// The unknowns of a line: turns about the frame's x and y, and shifts along them.
const OF_LINE: [usize; 4] = [0, 1, 3, 4];

impl JointModel {
    /// Returns the lines of the joints and where the target is, fitted to the poses that were seen, from this start nearby.
    /// Rows of one block stand together.
    ///
    /// # Panics
    ///
    /// If there are not as many blocks named as poses seen.
    pub fn fitted(self, seen: &[Pose], block_of_row: &[usize]) -> Result<PoseFit<Self>, PoseFitError> {
        fit_poses(self, seen, block_of_row)
    }
}

impl PoseModel for JointModel {
    fn columns(&self) -> usize {
        OF_LINE.len() * self.rig_from_joint.len() + 6
    }

    fn pose(&self, row: usize) -> Option<Pose> {
        let mut before = Pose::identity();
        for (rig_from_joint, angle) in self.rig_from_joint.iter().zip(self.angles_rad.get(row)?) {
            let turn = Pose::from_rodrigues(Vector3::z() * *angle, Vector3::zeros());
            before = before * *rig_from_joint * turn * rig_from_joint.inverse();
        }
        Some(before * self.rig_from_target)
    }

    fn predicted(&self, row: usize, by_unknowns: &mut Matrix6xX<f64>) -> Option<Pose> {
        let angles = self.angles_rad.get(row)?;
        let mut before = Pose::identity();
        for (joint, (rig_from_joint, angle)) in self.rig_from_joint.iter().zip(angles).enumerate() {
            let turn = Pose::from_rodrigues(Vector3::z() * *angle, Vector3::zeros());
            let to_joint = before * *rig_from_joint;
            // The frame moves by ξ on its right: exp(ξ) turn exp(-ξ) between what is before and after.
            let moved = to_joint.adjoint() * (Matrix6::identity() - turn.adjoint());
            for (i, column) in OF_LINE.into_iter().enumerate() {
                by_unknowns.view_mut((0, OF_LINE.len() * joint + i), (6, 1)).copy_from(&moved.column(column));
            }
            before = to_joint * turn * rig_from_joint.inverse();
        }
        let last = OF_LINE.len() * self.rig_from_joint.len();
        by_unknowns.view_mut((0, last), (6, 6)).copy_from(&before.adjoint());
        Some(before * self.rig_from_target)
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let mut moved = self.clone();
        for (joint, frame) in moved.rig_from_joint.iter_mut().enumerate() {
            let mut tangent = Vector6::zeros();
            for (i, column) in OF_LINE.into_iter().enumerate() {
                tangent[column] = step[OF_LINE.len() * joint + i];
            }
            *frame = (*frame * Pose::exp(&tangent)).perturbed(&Vector6::zeros());
        }
        let last = OF_LINE.len() * self.rig_from_joint.len();
        let tangent = Vector6::from_iterator(step.iter().skip(last).copied());
        moved.rig_from_target = moved.rig_from_target.perturbed(&tangent);
        moved
    }
}
