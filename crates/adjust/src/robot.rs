//! The robot's part of a problem: where rig and target sit on it, and how far its readings are believed.

use boresight_data::{Dataset, FrameId, IdVec, Mounting, Robot, Scene, Stretch, TargetId};
use boresight_geometry::nalgebra::SMatrix;
use boresight_geometry::{Matrix3, Pose, Vector3, Vector6, left_jacobian_inverse, skew};
use boresight_solver::{
    BlockId, Elimination, GramMut, Parameters, PosePrior, Scratch, Term, TermKind, Values, VectorPrior,
};

use crate::chain::Link;
use crate::options::RobotNoise;
use crate::robot_touch::{RobotTouches, Told, TouchBlocks, TouchedPoint};
use crate::touch::TipKnowledge;

/// How well a height that is held is known, in metres.
const HELD_HEIGHT_SIGMA_M: f64 = 1e-7;

/// The blocks of a robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RobotBlocks {
    pub mounting: Mounting,
    /// The rig on the flange or in the base.
    pub carrier_from_rig: BlockId,
    /// The first target in the base or on the flange.
    pub other_from_first: BlockId,
}

/// The robot's part of a problem.
#[derive(Clone, Debug, Default)]
pub(crate) struct RobotPart {
    pub blocks: Option<RobotBlocks>,
    /// For each frame with a reading that is not exact, the block of the true pose.
    pub arms: IdVec<FrameId, Option<BlockId>>,
    /// What the robot said, for each of these.
    pub readings: Vec<(FrameId, RobotReading)>,
    /// The map by which positions are off, where it is estimated, and what is believed of it.
    pub stretch: Option<StretchBlock>,
    /// The height that is held, where one is.
    pub height: Option<PosePrior>,
    /// The touching tip on what bears the rig, where points of targets were touched.
    pub tip: Option<BlockId>,
    /// These touches.
    pub touched: Vec<TouchedPoint>,
    /// What the robot said in them, where that is not exact.
    pub touch_readings: Vec<RobotReading>,
}

impl RobotPart {
    /// Adds the blocks of the scene's robot; none if there is no robot or nothing about it is unknown.
    pub(crate) fn new(
        dataset: &Dataset,
        scene: &Scene,
        noise: Option<RobotNoise>,
        parameters: &mut Parameters,
    ) -> Self {
        let arms = dataset.frames.ids().map(|_| None).collect();
        let blocks = scene.robot.as_ref().and_then(|robot| {
            let mounting = robot.mounting()?;
            Some(RobotBlocks {
                mounting,
                carrier_from_rig: parameters.add_pose(&robot.carrier_from_rig(), Elimination::Reduced),
                other_from_first: parameters.add_pose(&robot.other_from_target(), Elimination::Reduced),
            })
        });
        let sigma = noise.and_then(|noise| noise.stretch).filter(|_| blocks.is_some());
        let stretch = sigma.map(|sigma| {
            let known = scene.robot.as_ref().and_then(|robot| robot.stretch);
            let centre_in_base = known.map_or_else(|| middle(dataset), |known| known.centre_in_base);
            let block =
                parameters.add_vector(known.map_or_else(Matrix3::zeros, |known| known.matrix).as_slice());
            let belief = VectorPrior::new(block, (0..9).map(|i| (i, 0.0, 1.0 / sigma)).collect());
            StretchBlock { block, centre_in_base, sigma, belief }
        });
        Self { blocks, arms, stretch, ..Self::default() }
    }

    /// Returns the links `rig_from_first` of a frame, or `None` if no robot tells of it.
    pub(crate) fn links(
        &mut self,
        frame: FrameId,
        base_from_flange: Option<Pose>,
        noise: Option<RobotNoise>,
        parameters: &mut Parameters,
    ) -> Option<[Link; 3]> {
        let (blocks, base_from_flange) = (self.blocks?, base_from_flange?);
        let stretch = self.stretch.as_ref().map(|stretch| (stretch.block, stretch.centre_in_base));
        let arm = noise.map(|noise| {
            *self.arms[frame].get_or_insert_with(|| {
                let true_pose = stretch.map_or(base_from_flange, |(block, centre_in_base)| {
                    stretch_of(parameters.values().vector(block), centre_in_base).corrected(&base_from_flange)
                });
                let block = parameters.add_pose(&true_pose, Elimination::First);
                self.readings.push((frame, RobotReading::new(block, base_from_flange, noise, stretch)));
                block
            })
        });
        let link = match (blocks.mounting, arm) {
            (Mounting::RigOnFlange, Some(block)) => Link::Inverse(block),
            (Mounting::RigInBase, Some(block)) => Link::Block(block),
            (Mounting::RigOnFlange, None) => Link::Known(base_from_flange.inverse()),
            (Mounting::RigInBase, None) => Link::Known(base_from_flange),
        };
        Some([Link::Inverse(blocks.carrier_from_rig), link, Link::Block(blocks.other_from_first)])
    }

    /// Adds terms for points of targets that were touched. `blocks_of` returns a target's place and shape.
    pub(crate) fn add_touches(
        &mut self,
        dataset: &Dataset,
        touches: &RobotTouches,
        noise: Option<RobotNoise>,
        blocks_of: impl Fn(TargetId) -> [Option<BlockId>; 2],
        parameters: &mut Parameters,
    ) {
        let Some(robot) = self.blocks else { return };
        let (RobotBlocks { mounting, other_from_first, .. }, stretch) = (robot, self.stretch.as_ref());
        let stretch = stretch.map(|stretch| (stretch.block, stretch.centre_in_base));
        let tip = match touches.tip_in_carrier {
            TipKnowledge::Known(tip) => tip,
            TipKnowledge::Unknown => {
                // Where the touched points are on the tip's bearer, in the mean.
                let sum: Vector3<f64> = touches
                    .touches
                    .iter()
                    .map(|touch| {
                        let [first_from_target, shape] = blocks_of(touch.target);
                        let values = parameters.values();
                        let target = &dataset.targets[touch.target];
                        let point =
                            target.point(touch.point, shape.map_or(&[], |block| values.vector(block)));
                        let first = first_from_target.map_or_else(Pose::identity, |block| values.pose(block));
                        let carrier_from_other = match mounting {
                            Mounting::RigOnFlange => touch.base_from_flange.inverse(),
                            Mounting::RigInBase => touch.base_from_flange,
                        };
                        carrier_from_other * (values.pose(other_from_first) * (first * point))
                    })
                    .sum();
                (sum / touches.touches.len().max(1) as f64).into()
            }
        };
        let tip = parameters.add_vector(&tip);
        if let TipKnowledge::Known(_) = touches.tip_in_carrier {
            parameters.hold_all(tip);
        }
        self.tip = Some(tip);
        for touch in &touches.touches {
            let told = match noise {
                None => Told::Exactly(touch.base_from_flange),
                Some(noise) => {
                    let block = parameters.add_pose(&touch.base_from_flange, Elimination::First);
                    self.touch_readings.push(RobotReading::new(
                        block,
                        touch.base_from_flange,
                        noise,
                        stretch,
                    ));
                    Told::Block(block)
                }
            };
            let [first_from_target, shape] = blocks_of(touch.target);
            let blocks = TouchBlocks { mounting, other_from_first, tip, first_from_target, shape };
            let target = &dataset.targets[touch.target];
            self.touched.push(TouchedPoint::new(&blocks, told, target, touch.point, touches.sigma_m));
        }
    }

    /// Returns the readings of frames and of touches.
    pub(crate) fn all_readings(&self) -> impl Iterator<Item = &RobotReading> {
        self.readings.iter().map(|(_, reading)| reading).chain(&self.touch_readings)
    }

    /// Holds the height in the robot's base of what the base bears.
    pub(crate) fn hold_height(&mut self, parameters: &Parameters) {
        self.height = self.blocks.map(|blocks| {
            let block = match blocks.mounting {
                Mounting::RigOnFlange => blocks.other_from_first,
                Mounting::RigInBase => blocks.carrier_from_rig,
            };
            let sure = 1.0 / HELD_HEIGHT_SIGMA_M;
            PosePrior::new(block, parameters.values().pose(block), [0.0, 0.0, 0.0, 0.0, 0.0, sure])
        });
    }

    /// Writes what `values` say of the robot, and of the frames it tells of, into `scene`.
    pub(crate) fn write(&self, dataset: &Dataset, values: Values<'_>, scene: &mut Scene) {
        let Some(blocks) = self.blocks else { return };
        // A pointer in the work cell is no part of the robot.
        let tip = self.tip.filter(|_| blocks.mounting == Mounting::RigOnFlange);
        let tip = tip.map(|block| Vector3::from_column_slice(values.vector(block)));
        let tip_in_flange = tip.or(scene.robot.as_ref().and_then(|robot| robot.tip_in_flange));
        let before = scene.robot.as_ref().and_then(|robot| robot.stretch);
        let now = self
            .stretch
            .as_ref()
            .map(|stretch| stretch_of(values.vector(stretch.block), stretch.centre_in_base));
        let robot = Robot {
            tip_in_flange,
            stretch: now.or(before),
            ..Robot::mounted(
                blocks.mounting,
                values.pose(blocks.carrier_from_rig),
                values.pose(blocks.other_from_first),
            )
        };
        for (id, frame) in dataset.frames.enumerate() {
            // Where no camera saw the target there is no true pose but what the map makes of the robot's word.
            let said = frame.base_from_flange.map(|said| now.map_or(said, |map| map.corrected(&said)));
            if let Some(base_from_flange) = self.arms[id].map(|block| values.pose(block)).or(said) {
                scene.rig_from_target[id] = Some(robot.rig_from_target(&base_from_flange));
            }
        }
        scene.robot = Some(robot);
    }

    /// Returns the terms beside the views'.
    pub(crate) fn terms(&self) -> impl Iterator<Item = &dyn Term> {
        let readings = self.all_readings().map(|reading| reading as &dyn Term);
        let readings = readings.chain(self.touched.iter().map(|touched| touched as &dyn Term));
        let stretch = self.stretch.iter().map(|stretch| &stretch.belief as &dyn Term);
        readings.chain(stretch).chain(self.height.iter().map(|height| height as &dyn Term))
    }
}

/// The map by which a robot's positions are off.
#[derive(Clone, Debug)]
pub(crate) struct StretchBlock {
    /// Its nine numbers, column by column.
    pub block: BlockId,
    pub centre_in_base: Vector3<f64>,
    /// The sigma of each.
    pub sigma: f64,
    belief: VectorPrior,
}

fn stretch_of(numbers: &[f64], centre_in_base: Vector3<f64>) -> Stretch {
    Stretch { centre_in_base, matrix: Matrix3::from_column_slice(numbers) }
}

/// Returns the mean of all positions that the robot said.
fn middle(dataset: &Dataset) -> Vector3<f64> {
    let said = dataset.frames.iter().filter_map(|frame| frame.base_from_flange);
    let positions: Vec<Vector3<f64>> = said.map(|pose| pose.translation).collect();
    positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64
}

/// A pose that a robot said, as a measurement of the true one.
#[derive(Clone, Debug)]
pub(crate) struct RobotReading {
    /// The true pose, and the map by which positions are off, if that is estimated.
    blocks: Vec<BlockId>,
    base_from_flange: Pose,
    centre_in_base: Vector3<f64>,
    noise: RobotNoise,
}

/// The columns of a reading: of the pose, and of the map.
const POSE_COLUMNS: usize = 6;
const ALL_COLUMNS: usize = POSE_COLUMNS + 9;

impl RobotReading {
    fn new(
        block: BlockId,
        base_from_flange: Pose,
        noise: RobotNoise,
        stretch: Option<(BlockId, Vector3<f64>)>,
    ) -> Self {
        let blocks = [block].into_iter().chain(stretch.map(|(block, _)| block)).collect();
        let centre_in_base = stretch.map_or_else(Vector3::zeros, |(_, centre)| centre);
        Self { blocks, base_from_flange, centre_in_base, noise }
    }

    /// Returns the block of the true pose.
    pub(crate) fn pose(&self) -> BlockId {
        self.blocks[0]
    }

    /// Returns the residuals in sigmas, rotation first, and their derivatives by the pose and the map.
    pub(crate) fn rows(&self, values: Values<'_>) -> (Vector6<f64>, SMatrix<f64, 6, ALL_COLUMNS>) {
        let pose = values.pose(self.blocks[0]);
        let said = match self.blocks.get(1) {
            Some(&block) => {
                stretch_of(values.vector(block), self.centre_in_base).corrected(&self.base_from_flange)
            }
            None => self.base_from_flange,
        };
        let rotation = Pose::new(pose.rotation * said.rotation.inverse(), Vector3::zeros()).rodrigues();
        let mut residual = Vector6::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&rotation);
        residual.fixed_rows_mut::<3>(3).copy_from(&(pose.translation - said.translation));
        let mut jacobian = SMatrix::<f64, 6, ALL_COLUMNS>::zeros();
        // A left perturbation (w, v) turns the rotation by w and moves the translation by w × t + v.
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&left_jacobian_inverse(&rotation));
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&pose.translation));
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&Matrix3::identity());
        let offset = self.base_from_flange.translation - self.centre_in_base;
        for axis in 0..3 {
            let column = POSE_COLUMNS + 3 * axis;
            let by_column = Matrix3::identity() * -offset[axis];
            jacobian.fixed_view_mut::<3, 3>(3, column).copy_from(&by_column);
        }
        for row in 0..6 {
            let sigma = if row < 3 { self.noise.rotation_rad } else { self.noise.translation_m };
            residual[row] /= sigma;
            jacobian.row_mut(row).scale_mut(1.0 / sigma);
        }
        (residual, jacobian)
    }
}

impl Term for RobotReading {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn kind(&self) -> TermKind {
        TermKind::Observation
    }

    fn row_count(&self) -> usize {
        6
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let (residual, jacobian) = self.rows(values);
        Some(gram.add_rows(&jacobian, &residual))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_readings_derivatives_match_differences() {
        let pose = |a: f64| Pose::from_rodrigues(Vector3::new(a, 0.3, -0.2), Vector3::new(0.5, a, 0.9));
        let mut parameters = Parameters::default();
        let block = parameters.add_pose(&pose(0.4), Elimination::First);
        let map = [0.01, 0.0, -0.02, 0.0, 0.03, 0.0, 0.01, 0.0, 0.02];
        let stretch = parameters.add_vector(&map);
        let noise = RobotNoise { rotation_rad: 0.1, translation_m: 0.5, stretch: Some(1.0) };
        let centre = Vector3::new(0.1, 0.2, 0.3);
        let reading = RobotReading::new(block, pose(0.35), noise, Some((stretch, centre)));
        let (residual, jacobian) = reading.rows(parameters.values());
        let step = 1e-6;
        for column in 0..ALL_COLUMNS {
            let mut tangent = vec![0.0; ALL_COLUMNS];
            tangent[column] = step;
            let mut moved = Vec::new();
            parameters.retract(parameters.values().as_slice(), &tangent, &mut moved);
            let (other, _) = reading.rows(parameters.at(&moved));
            // One-sided differences are good to the step times the curvature, of order one over the sigma.
            let error = ((other - residual) / step - jacobian.column(column)).norm();
            assert!(error < 1e-4, "{column}: {error}");
        }
    }
}
