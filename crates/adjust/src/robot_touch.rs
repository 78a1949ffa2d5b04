//! Points of targets that a robot's tip touched, as part of the adjustment with the cameras.
//!
//! The tip is borne by what bears the rig: it is on the flange beside the cameras, or a pointer in the work cell of
//! fixed ones. So one equation serves both, as for sights:
//! `other_from_carrier * tip_in_carrier = other_from_first * first_from_target * point_in_target`.

use boresight_data::{Mounting, PointId, Shape, Target, TargetId};
use boresight_geometry::nalgebra::Matrix3xX;
use boresight_geometry::{Matrix3, Pose, Vector3, skew};
use boresight_solver::{BlockId, GramMut, Scratch, Term, TermKind, Values};

use crate::touch::TipKnowledge;

/// Points that were touched.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotTouches {
    /// The tip on what bears the rig: on the flange of mobile cameras, in the base of fixed ones. An unknown one is
    /// estimated with everything else.
    pub tip_in_carrier: TipKnowledge,
    /// How far a touch misses its point, along each axis, in metres; like the robot's noise in units of the pixels'
    /// stated sigmas: the true one over the noise factor.
    pub sigma_m: f64,
    /// The touches.
    pub touches: Vec<RobotTouch>,
}

/// A point that was touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotTouch {
    /// Where the robot said its flange was.
    pub base_from_flange: Pose,
    /// The target.
    pub target: TargetId,
    /// Which of its points.
    pub point: PointId,
}

/// Where the robot was in a touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Told {
    /// `base_from_flange` as the robot said it.
    Exactly(Pose),
    /// The block of the true `base_from_flange`.
    Block(BlockId),
}

/// A touch as a term of the sum of squares: where the tip was less where the point is, in sigmas.
#[derive(Clone, Debug)]
pub(crate) struct TouchedPoint {
    /// In the order of the columns: the target, the tip, and what there is of the arm, the second target and the shape.
    blocks: Vec<BlockId>,
    mounting: Mounting,
    told: Told,
    first_from_target: Option<BlockId>,
    shape: Option<BlockId>,
    drawn: Vector3<f64>,
    /// By how much a unit of each shape coefficient lifts the point along the target's z.
    basis: [f64; Shape::MOST_COEFFICIENTS],
    sigma_m: f64,
}

/// The blocks that a touch is about.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TouchBlocks {
    pub mounting: Mounting,
    pub other_from_first: BlockId,
    pub tip: BlockId,
    pub first_from_target: Option<BlockId>,
    pub shape: Option<BlockId>,
}

impl TouchedPoint {
    pub(crate) fn new(
        blocks: &TouchBlocks,
        told: Told,
        target: &Target,
        point: PointId,
        sigma_m: f64,
    ) -> Self {
        let arm = match told {
            Told::Block(block) => Some(block),
            Told::Exactly(_) => None,
        };
        let others = [arm, blocks.first_from_target, blocks.shape];
        Self {
            blocks: [blocks.other_from_first, blocks.tip]
                .into_iter()
                .chain(others.into_iter().flatten())
                .collect(),
            mounting: blocks.mounting,
            told,
            first_from_target: blocks.first_from_target,
            shape: blocks.shape,
            drawn: target.drawn_point(point),
            basis: target.shape_basis(point),
            sigma_m,
        }
    }

    /// Returns the residual in metres and its derivatives, a column for each of the blocks' in their order.
    fn rows(&self, values: Values<'_>) -> (Vector3<f64>, Matrix3xX<f64>) {
        let base_from_flange = match self.told {
            Told::Exactly(pose) => pose,
            Told::Block(block) => values.pose(block),
        };
        let other_from_carrier = match self.mounting {
            Mounting::RigOnFlange => base_from_flange,
            Mounting::RigInBase => base_from_flange.inverse(),
        };
        let (other_from_first, tip) = (values.pose(self.blocks[0]), values.vector(self.blocks[1]));
        let tip = Vector3::new(tip[0], tip[1], tip[2]);
        let coefficients: &[f64] = self.shape.map_or(&[], |block| values.vector(block));
        let lift: f64 = self.basis.iter().zip(coefficients).map(|(basis, size)| basis * size).sum();
        let point_in_target = self.drawn + Vector3::z() * lift;
        let first_from_target =
            self.first_from_target.map_or_else(Pose::identity, |block| values.pose(block));
        let point_in_first = first_from_target * point_in_target;
        let (touched, point) = (other_from_carrier * tip, other_from_first * point_in_first);
        let target_turn = other_from_first.rotation_matrix();

        // A left perturbation (w, v) of a pose moves what it takes to p by w × p + v.
        let mut columns: Vec<Vector3<f64>> = Vec::with_capacity(6 + 3 + 6 + 6 + self.basis.len());
        let mut push =
            |block: &Matrix3<f64>| columns.extend(block.column_iter().map(|column| column.into_owned()));
        push(&skew(&point));
        push(&-Matrix3::identity());
        push(&other_from_carrier.rotation_matrix());
        if let Told::Block(_) = self.told {
            match self.mounting {
                Mounting::RigOnFlange => {
                    push(&-skew(&touched));
                    push(&Matrix3::identity());
                }
                Mounting::RigInBase => {
                    // The inverse moves what it takes from p by the opposite, turned as it turns.
                    let turn = other_from_carrier.rotation_matrix();
                    push(&(turn * skew(&tip)));
                    push(&-turn);
                }
            }
        }
        if self.first_from_target.is_some() {
            push(&(target_turn * skew(&point_in_first)));
            push(&-target_turn);
        }
        if let Some(shape) = self.shape {
            let up = target_turn * (first_from_target.rotation * Vector3::z());
            columns.extend(self.basis.iter().take(values.vector(shape).len()).map(|basis| up * -*basis));
        }
        (touched - point, Matrix3xX::from_columns(&columns))
    }
}

impl Term for TouchedPoint {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn kind(&self) -> TermKind {
        TermKind::Observation
    }

    fn row_count(&self) -> usize {
        3
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let (residual, jacobian) = self.rows(values);
        Some(gram.add_rows(&(jacobian / self.sigma_m), &(residual / self.sigma_m)))
    }
}

#[cfg(test)]
mod tests {
    use boresight_data::{Geometry, Id as _};
    use boresight_solver::{Elimination, Parameters};

    use super::*;

    #[test]
    fn a_touchs_derivatives_match_differences() {
        let pose = |a: f64| Pose::from_rodrigues(Vector3::new(a, 0.3, -0.2), Vector3::new(0.5, a, 0.9));
        let geometry = Geometry::Chessboard { columns: 5, rows: 4, spacing_m: 0.1 };
        let target = Target { name: "board".to_owned(), geometry, shape: Shape::Twisted6 };
        for mounting in [Mounting::RigOnFlange, Mounting::RigInBase] {
            let mut parameters = Parameters::default();
            let blocks = TouchBlocks {
                mounting,
                other_from_first: parameters.add_pose(&pose(0.7), Elimination::Reduced),
                tip: parameters.add_vector(&[0.1, -0.05, 0.2]),
                first_from_target: Some(parameters.add_pose(&pose(-0.3), Elimination::Reduced)),
                shape: Some(parameters.add_vector(&[0.02, -0.01, 0.03, 0.01, -0.02, 0.015])),
            };
            let arm = parameters.add_pose(&pose(0.4), Elimination::Reduced);
            let term = TouchedPoint::new(&blocks, Told::Block(arm), &target, PointId::from_index(8), 1.0);
            let (residual, jacobian) = term.rows(parameters.values());
            let offset = |block: BlockId| parameters.columns(block).start;
            let order: Vec<usize> = term
                .blocks()
                .iter()
                .flat_map(|&block| offset(block)..parameters.columns(block).end)
                .collect();
            assert_eq!(order.len(), jacobian.ncols());
            for (column, &place) in order.iter().enumerate() {
                let step = 1e-6;
                let mut tangent = vec![0.0; order.len()];
                tangent[place] = step;
                let mut moved = Vec::new();
                parameters.retract(parameters.values().as_slice(), &tangent, &mut moved);
                let (other, _) = term.rows(parameters.at(&moved));
                // One-sided differences are good to the step.
                let error = ((other - residual) / step - jacobian.column(column)).norm();
                assert!(error < 1e-5, "{mounting:?} {column}: {error}");
            }
        }
    }
}
