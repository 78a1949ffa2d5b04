//! The robot's part of a problem: where rig and target sit on it, and how far its readings are believed.

use boresight_data::{Dataset, FrameId, IdVec, Mounting, Robot, Scene};
use boresight_geometry::{Matrix6, Pose, Vector6};
use boresight_solver::{
    BlockId, Elimination, GramMut, Parameters, PosePrior, Scratch, Term, TermKind, Values,
};

use crate::chain::Link;
use crate::options::RobotNoise;

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
    /// The height that is held, where one is.
    pub height: Option<PosePrior>,
}

impl RobotPart {
    /// Adds the blocks of the scene's robot; none if there is no robot or nothing about it is unknown.
    pub(crate) fn new(dataset: &Dataset, scene: &Scene, parameters: &mut Parameters) -> Self {
        let arms = dataset.frames.ids().map(|_| None).collect();
        let blocks = scene.robot.as_ref().and_then(|robot| {
            let mounting = robot.mounting()?;
            Some(RobotBlocks {
                mounting,
                carrier_from_rig: parameters.add_pose(&robot.carrier_from_rig(), Elimination::Reduced),
                other_from_first: parameters.add_pose(&robot.other_from_target(), Elimination::Reduced),
            })
        });
        Self { blocks, arms, ..Self::default() }
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
        let arm = noise.map(|noise| {
            *self.arms[frame].get_or_insert_with(|| {
                let block = parameters.add_pose(&base_from_flange, Elimination::First);
                self.readings.push((frame, RobotReading::new(block, base_from_flange, noise)));
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
        let tip_in_flange = scene.robot.as_ref().and_then(|robot| robot.tip_in_flange);
        let robot = Robot {
            tip_in_flange,
            ..Robot::mounted(
                blocks.mounting,
                values.pose(blocks.carrier_from_rig),
                values.pose(blocks.other_from_first),
            )
        };
        for (id, frame) in dataset.frames.enumerate() {
            let said = self.arms[id].map(|block| values.pose(block)).or(frame.base_from_flange);
            if let Some(base_from_flange) = said {
                scene.rig_from_target[id] = Some(robot.rig_from_target(&base_from_flange));
            }
        }
        scene.robot = Some(robot);
    }

    /// Returns the terms beside the views'.
    pub(crate) fn terms(&self) -> impl Iterator<Item = &dyn Term> {
        let readings = self.readings.iter().map(|(_, reading)| reading as &dyn Term);
        readings.chain(self.height.iter().map(|height| height as &dyn Term))
    }
}

/// A pose that a robot said, as a measurement of the true one.
#[derive(Clone, Debug)]
pub(crate) struct RobotReading {
    /// The true pose.
    pub block: BlockId,
    belief: PosePrior,
}

impl RobotReading {
    fn new(block: BlockId, base_from_flange: Pose, noise: RobotNoise) -> Self {
        let (rotation, translation) = (1.0 / noise.rotation_rad, 1.0 / noise.translation_m);
        let inverse_sigmas = [rotation, rotation, rotation, translation, translation, translation];
        Self { block, belief: PosePrior::new(block, base_from_flange, inverse_sigmas) }
    }

    /// Returns the residuals in sigmas, rotation first, and their derivatives by the pose.
    pub(crate) fn rows(&self, values: Values<'_>) -> (Vector6<f64>, Matrix6<f64>) {
        self.belief.rows(&values.pose(self.block))
    }
}

impl Term for RobotReading {
    fn blocks(&self) -> &[BlockId] {
        self.belief.blocks()
    }

    fn kind(&self) -> TermKind {
        TermKind::Observation
    }

    fn row_count(&self) -> usize {
        self.belief.row_count()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, scratch: &mut Scratch) -> Option<f64> {
        self.belief.linearize(values, gram, scratch)
    }
}
