//! A dataset and a scene as a problem: which block is what.

use std::cell::OnceCell;
use std::sync::Arc;

use boresight_camera::Model;
use boresight_data::{CameraId, Dataset, FrameId, Id, IdVec, Observation, Scene, Shape, TargetId};
use boresight_geometry::Pose;
use boresight_geometry::nalgebra::DMatrix;
use boresight_solver::{
    BlockId, CompositeColumns, Elimination, JointBelief, JointPrior, Parameters, Problem, SparsePrior, Term,
    Threads, Values, VectorPrior,
};

use crate::chain::{CLOCK_COLUMN, Chain, LINE_DELAY_COLUMN, Link, clock, line_delay, seconds};
use crate::error::Error;
use crate::options::{AdjustOptions, Clock, Hold, Prior, Quantity, RobotNoise, Share};
use crate::reprojection::{Layouts, Reprojection, TargetPoints};
use crate::robot::RobotPart;
use crate::robot_touch::RobotTouch;

/// The blocks and terms of a rig looking at targets.
pub(crate) struct RigProblem {
    pub parameters: Parameters,
    pub cameras: IdVec<CameraId, Option<CameraBlocks>>,
    pub frames: IdVec<FrameId, Option<BlockId>>,
    pub targets: IdVec<TargetId, TargetBlocks>,
    /// The terms, and for each the view it is of.
    pub views: Vec<(usize, Reprojection)>,
    pub priors: Vec<VectorPrior>,
    /// Those of lenses with very many parameters.
    pub sparse_priors: Vec<SparsePrior>,
    pub robot: RobotPart,
    /// What is believed from elsewhere.
    pub beliefs: Vec<JointPrior>,
}

/// The blocks of a camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraBlocks {
    pub lens: BlockId,
    pub cam_from_rig: BlockId,
    /// How late its images and their rows are, where that is not zero or estimated.
    pub late: Option<BlockId>,
    /// Whether its rows are of different times.
    pub is_rolling: bool,
    pub is_reference: bool,
    pub model: Model,
}

/// The blocks of a target.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TargetBlocks {
    pub shape: Option<BlockId>,
    /// Where the target stands relative to the first; `None` for the first itself.
    pub first_from_target: Option<BlockId>,
}

/// What a view's term is made of, its observations apart.
struct Plan {
    view_idx: usize,
    model: Model,
    lens: BlockId,
    shape: Option<(BlockId, usize)>,
    chain: Chain,
    /// Where each observation was seen, for a camera that takes one row after another of what moves.
    rows_from_middle: Option<Vec<f64>>,
    /// What terms have in common: the points of the target, if as many as it has were seen, and the layout.
    whole_target: Option<Arc<TargetPoints>>,
    layout: Arc<CompositeColumns>,
}

impl Plan {
    /// Returns the view and its term.
    fn term(self, dataset: &Dataset) -> Result<(usize, Reprojection), Error> {
        let Self { view_idx, model, lens, shape, chain, rows_from_middle, whole_target, layout } = self;
        let view = &dataset.views[view_idx];
        let observations = &view.observations;
        check_sigmas(view_idx, observations)?;
        let is_whole =
            || observations.iter().enumerate().all(|(idx, observation)| observation.point.index() == idx);
        let points = || Arc::new(TargetPoints::new(&dataset.targets[view.target], observations));
        let points = whole_target.filter(|_| is_whole()).unwrap_or_else(points);
        let term = Reprojection::laid_out(model, lens, shape, chain, points, observations, layout);
        Ok((
            view_idx,
            match rows_from_middle {
                Some(rows) => term.with_row_times(rows),
                None => term,
            },
        ))
    }
}

impl RigProblem {
    pub(crate) fn new(dataset: &Dataset, scene: &Scene, options: &AdjustOptions) -> Result<Self, Error> {
        check(dataset, scene)?;
        let reference = scene.rig.reference().ok_or(Error::NoCamera { views: dataset.views.len() })?;
        let mut parameters = Parameters::default();
        let mut cameras: IdVec<CameraId, Option<CameraBlocks>> = IdVec::default();
        // Surveyed boards give the rig its frame; otherwise the reference camera does.
        let is_surveyed = options.holds.iter().any(|hold| matches!(hold, Hold::RigFromTarget(_)))
            || options
                .priors
                .iter()
                .flat_map(|prior| &prior.quantities)
                .any(|quantity| matches!(quantity, Quantity::RigFromTarget(..)));
        for (camera_id, camera) in scene.rig.cameras.enumerate() {
            let shared = shared_lens(camera_id, &options.shares, &cameras, scene)?;
            cameras.push(camera.as_ref().map(|camera| {
                let lens = shared.unwrap_or_else(|| parameters.add_vector(&camera.camera.params));
                let cam_from_rig = parameters.add_pose(&camera.cam_from_rig, Elimination::Reduced);
                let is_reference = camera_id == reference && !is_surveyed;
                if is_reference {
                    parameters.hold_all(cam_from_rig);
                }
                let free: Vec<usize> = options
                    .clocks
                    .iter()
                    .filter_map(|clock| match clock {
                        Clock::Offset(id) => (*id == camera_id).then_some(CLOCK_COLUMN),
                        Clock::LineDelay(id) => (*id == camera_id).then_some(LINE_DELAY_COLUMN),
                    })
                    .collect();
                let is_rolling = camera.line_delay_s != 0.0 || free.contains(&LINE_DELAY_COLUMN);
                let late = (is_rolling || camera.time_offset_s != 0.0 || !free.is_empty()).then(|| {
                    let clock = clock(camera.time_offset_s, camera.line_delay_s);
                    let late = parameters.add_pose(&clock, Elimination::Reduced);
                    for column in (0..6).filter(|column| !free.contains(column)) {
                        parameters.hold(late, column);
                    }
                    late
                });
                let model = camera.camera.model;
                CameraBlocks { lens, cam_from_rig, late, is_rolling, is_reference, model }
            }));
        }
        let mut targets = IdVec::default();
        for (target_id, belief) in scene.targets.enumerate() {
            let is_seen = dataset.views.iter().any(|view| view.target == target_id);
            let shape = (dataset.targets[target_id].shape != Shape::Rigid && is_seen).then(|| {
                // Shapes with more coefficients begin with those with fewer.
                let mut shape_m = belief.shape_m.clone();
                shape_m.resize(dataset.targets[target_id].shape.coefficient_count(), 0.0);
                parameters.add_vector(&shape_m)
            });
            let first_from_target = (target_id.index() > 0 && is_seen)
                .then(|| parameters.add_pose(&belief.first_from_target, Elimination::Reduced));
            targets.push(TargetBlocks { shape, first_from_target });
        }
        let robot = RobotPart::new(dataset, scene, options.robot_noise, &mut parameters);
        let mut problem = Self {
            parameters,
            cameras,
            frames: dataset.frames.ids().map(|_| None).collect(),
            targets,
            views: Vec::new(),
            priors: Vec::new(),
            sparse_priors: Vec::new(),
            robot,
            beliefs: Vec::new(),
        };
        problem.add_views(dataset, scene, options.robot_noise, options.threads)?;
        problem.add_touches(dataset, options)?;
        problem.hold(&options.holds);
        problem.add_regularization(dataset, scene, options);
        problem.add_beliefs(&options.priors)?;
        Ok(problem)
    }

    /// Adds a term for each view whose camera and frame the scene knows.
    fn add_views(
        &mut self,
        dataset: &Dataset,
        scene: &Scene,
        noise: Option<RobotNoise>,
        threads: usize,
    ) -> Result<(), Error> {
        let mut plans = Vec::with_capacity(dataset.views.len());
        // What terms share is looked up here: threads that count up its uses at once wait for each other.
        let whole_targets: IdVec<TargetId, OnceCell<_>> =
            dataset.targets.iter().map(|_| OnceCell::new()).collect();
        let layouts = Layouts::default();
        for (view_idx, view) in dataset.views.iter().enumerate() {
            let (Some(camera), Some(rig_camera)) =
                (self.cameras[view.camera], &scene.rig.cameras[view.camera])
            else {
                continue;
            };
            if view.observations.is_empty() {
                continue;
            }
            let said = dataset.frames[view.frame].base_from_flange;
            let by_robot = self.robot.links(view.frame, said, noise, &mut self.parameters);
            let model = rig_camera.camera.model;
            if by_robot.is_some() && model.local_support().is_some() {
                // Sums of knots with poses are kept for a pose that is eliminated first, and a robot has none.
                return Err(Error::LocalLensOnRobot { camera: view.camera, model: model.name() });
            }
            let to_first = match (by_robot, scene.rig_from_target[view.frame]) {
                (Some(links), _) => links.to_vec(),
                (None, Some(rig_from_target)) => {
                    let frame = *self.frames[view.frame].get_or_insert_with(|| {
                        self.parameters.add_pose(&rig_from_target, Elimination::First)
                    });
                    vec![Link::Block(frame)]
                }
                (None, None) => continue,
            };
            let blocks = self.targets[view.target];
            let motion = scene.motion.get(view.frame).copied().flatten().filter(|_| camera.late.is_some());
            // The reference camera's pose is the identity and held, which the chain can leave out; but its first link is one
            // that all of the rig moves through.
            let at_rig =
                camera.is_reference && rig_camera.cam_from_rig == Pose::identity() && motion.is_none();
            let links = (!at_rig)
                .then_some(Link::Block(camera.cam_from_rig))
                .into_iter()
                .chain(camera.late.zip(motion).map(|(late, motion)| Link::Late(late, motion)))
                .chain(to_first)
                .chain(blocks.first_from_target.map(Link::Block));
            let chain = Chain { links: links.collect() };
            let n_shape = dataset.targets[view.target].shape.coefficient_count();
            let shape = blocks.shape.map(|block| (block, n_shape));
            let is_rolling = camera.is_rolling && motion.is_some();
            if is_rolling && model.local_support().is_some() {
                return Err(Error::LocalLensRolling { camera: view.camera, model: model.name() });
            }
            let row = |seen: &Observation| rig_camera.rows_from_middle(seen.pixel[1]);
            let rows_from_middle = is_rolling.then(|| view.observations.iter().map(row).collect());
            let target = &dataset.targets[view.target];
            let whole_target = (view.observations.len() == target.point_count()).then(|| {
                let whole = &whole_targets[view.target];
                whole.get_or_init(|| Arc::new(TargetPoints::whole(target))).clone()
            });
            plans.push(Plan {
                view_idx,
                model,
                lens: camera.lens,
                shape,
                chain,
                rows_from_middle,
                whole_target,
                layout: layouts.get(model, shape.map_or(0, |(_, n)| n)),
            });
        }
        let n_rows = plans.iter().map(|plan| 2 * dataset.views[plan.view_idx].observations.len()).sum();
        let terms = Threads::new(threads, n_rows)?.map(plans, |plan| plan.term(dataset));
        self.views = terms.into_iter().collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Adds a term for each touch of a target.
    fn add_touches(&mut self, dataset: &Dataset, options: &AdjustOptions) -> Result<(), Error> {
        let Some(touches) = &options.robot_touches else { return Ok(()) };
        for (touch_idx, &RobotTouch { target, point, .. }) in touches.touches.iter().enumerate() {
            let is_there = dataset.targets.get(target).is_some_and(|info| point.index() < info.point_count())
                && (target.index() == 0 || self.targets[target].first_from_target.is_some());
            let sigma_m = touches.sigma_m;
            if !(is_there && sigma_m > 0.0 && sigma_m.is_finite()) {
                return Err(Error::BadTouch { touch_idx, target, point, sigma_m });
            }
        }
        let targets = &self.targets;
        let blocks_of = |target: TargetId| [targets[target].first_from_target, targets[target].shape];
        self.robot.add_touches(dataset, touches, options.robot_noise, blocks_of, &mut self.parameters);
        Ok(())
    }

    /// Adds the priors; of what this problem does not have, such as a frame that nothing sees, nothing is believed.
    fn add_beliefs(&mut self, priors: &[Prior]) -> Result<(), Error> {
        for (prior_idx, prior) in priors.iter().enumerate() {
            let bad = Error::BadPrior { prior_idx };
            // The columns of one block may be apart: gathered, with the covariance in their new order.
            let mut beliefs: Vec<(JointBelief, Vec<usize>)> = Vec::new();
            let (mut n_columns, mut n_frames) = (0, 0);
            for quantity in &prior.quantities {
                let n = if matches!(quantity, Quantity::LensParam(..)) { 1 } else { 6 };
                let places: Vec<usize> = (n_columns..n_columns + n).collect();
                n_columns += n;
                let Some(belief) = self.belief(quantity).ok_or_else(|| bad.clone())? else { continue };
                n_frames += usize::from(matches!(quantity, Quantity::RigFromTarget(..)));
                let same = beliefs.iter_mut().find(|(known, _)| match (known, &belief) {
                    (JointBelief::Numbers(a, _), JointBelief::Numbers(b, _)) => a == b,
                    _ => false,
                });
                match (same, belief) {
                    (Some((JointBelief::Numbers(_, numbers), known)), JointBelief::Numbers(_, more)) => {
                        numbers.extend(more);
                        known.extend(places);
                    }
                    (_, belief) => beliefs.push((belief, places)),
                }
            }
            // Frames' poses are eliminated one by one, so that no term may see two of them.
            if prior.covariance.len() != n_columns * n_columns || n_frames > 1 {
                return Err(bad);
            }
            let order: Vec<usize> = beliefs.iter().flat_map(|(_, places)| places.clone()).collect();
            let n = order.len();
            let covariance = DMatrix::from_fn(n, n, |i, j| prior.covariance[order[i] * n_columns + order[j]]);
            let beliefs = beliefs.into_iter().map(|(belief, _)| belief).collect();
            if n > 0 {
                self.beliefs.push(JointPrior::new(beliefs, &covariance).ok_or(bad)?);
            }
        }
        Ok(())
    }

    /// Returns a belief for the solver; within `None` it is about something that this problem does not have,
    /// and `None` itself is about something that does not exist.
    fn belief(&self, quantity: &Quantity) -> Option<Option<JointBelief>> {
        Some(match *quantity {
            Quantity::LensParam(camera, param, mean) => match self.cameras.get(camera)? {
                Some(blocks) if param >= self.parameters.columns(blocks.lens).len() => return None,
                Some(blocks) => Some(JointBelief::Numbers(blocks.lens, vec![(param, mean)])),
                None => None,
            },
            Quantity::CamFromRig(camera, mean) => {
                let blocks = self.cameras.get(camera)?;
                blocks.map(|blocks| JointBelief::Pose(blocks.cam_from_rig, mean))
            }
            Quantity::RigFromTarget(frame, mean) => {
                let block = self.frames.get(frame)?;
                block.map(|block| JointBelief::Pose(block, mean))
            }
        })
    }

    fn hold(&mut self, holds: &[Hold]) {
        for hold in holds {
            match *hold {
                Hold::LensParam(camera, param) => {
                    if let Some(blocks) = self.cameras[camera] {
                        self.parameters.hold(blocks.lens, param);
                    }
                }
                Hold::Lens(camera) => {
                    if let Some(blocks) = self.cameras[camera] {
                        self.parameters.hold_all(blocks.lens);
                    }
                }
                Hold::CamFromRig(camera) => {
                    if let Some(blocks) = self.cameras[camera] {
                        self.parameters.hold_all(blocks.cam_from_rig);
                    }
                }
                Hold::RigFromTarget(frame) => {
                    if let Some(block) = self.frames[frame] {
                        self.parameters.hold_all(block);
                    }
                }
                Hold::CarrierFromRig => {
                    if let Some(blocks) = self.robot.blocks {
                        self.parameters.hold_all(blocks.carrier_from_rig);
                    }
                }
                Hold::BaseHeight => self.robot.hold_height(&self.parameters),
                Hold::FirstFromTarget(target) => {
                    if let Some(block) = self.targets[target].first_from_target {
                        self.parameters.hold_all(block);
                    }
                }
                Hold::Shapes => {
                    for shape in self.targets.iter().filter_map(|blocks| blocks.shape) {
                        self.parameters.hold_all(shape);
                    }
                }
            }
        }
    }

    /// Returns the problem for the solver.
    pub(crate) fn problem(&self) -> Result<Problem<'_>, Error> {
        let views = self.views.iter().map(|(_, term)| term as &dyn Term);
        let priors = self.priors.iter().map(|prior| prior as &dyn Term);
        let sparse_priors = self.sparse_priors.iter().map(|prior| prior as &dyn Term);
        let beliefs = self.beliefs.iter().map(|belief| belief as &dyn Term);
        let terms = views.chain(priors).chain(sparse_priors).chain(self.robot.terms()).chain(beliefs);
        Ok(Problem::new(&self.parameters, terms.collect())?)
    }

    /// Returns the names of a camera's lens parameters.
    pub(crate) fn lens_names(&self, camera: CameraId) -> Vec<&'static str> {
        self.cameras[camera].map_or(Vec::new(), |blocks| blocks.model.param_names())
    }

    /// Returns `scene` with what `values` say of it.
    pub(crate) fn scene(&self, dataset: &Dataset, scene: &Scene, values: Values<'_>) -> Scene {
        let mut scene = scene.clone();
        for (blocks, camera) in self.cameras.iter().zip(scene.rig.cameras.iter_mut()) {
            if let (Some(blocks), Some(camera)) = (blocks, camera) {
                camera.camera.params = values.vector(blocks.lens).to_vec();
                camera.cam_from_rig = values.pose(blocks.cam_from_rig);
                if let Some(late) = blocks.late {
                    camera.time_offset_s = seconds(values, late);
                    camera.line_delay_s = line_delay(values, late);
                }
            }
        }
        for (blocks, belief) in self.targets.iter().zip(scene.targets.iter_mut()) {
            if let Some(shape) = blocks.shape {
                belief.shape_m = values.vector(shape).to_vec();
            }
            if let Some(pose) = blocks.first_from_target {
                belief.first_from_target = values.pose(pose);
            }
        }
        for (block, pose) in self.frames.iter().zip(scene.rig_from_target.iter_mut()) {
            *pose = block.map(|block| values.pose(block));
        }
        self.robot.write(dataset, values, &mut scene);
        scene
    }
}

/// Returns the lens of an earlier camera that this one shares.
fn shared_lens(
    camera: CameraId,
    shares: &[Share],
    cameras: &IdVec<CameraId, Option<CameraBlocks>>,
    scene: &Scene,
) -> Result<Option<BlockId>, Error> {
    let Some(own) = &scene.rig.cameras[camera] else { return Ok(None) };
    for Share::Lens(sharing) in shares.iter().filter(|Share::Lens(sharing)| sharing.contains(&camera)) {
        let earlier =
            sharing.iter().find_map(|other| Some((*other, cameras.get(*other).copied().flatten()?)));
        let Some((other, blocks)) = earlier else { continue };
        if blocks.model != own.camera.model {
            let models = [blocks.model.name(), own.camera.model.name()];
            return Err(Error::LensesDiffer { cameras: [other, camera], models });
        }
        return Ok(Some(blocks.lens));
    }
    Ok(None)
}

fn check_sigmas(view_idx: usize, observations: &[Observation]) -> Result<(), Error> {
    for (observation_idx, observation) in observations.iter().enumerate() {
        let sigma_px = observation.sigma_px;
        let is_sigma = sigma_px > 0.0 && sigma_px < f64::INFINITY;
        if !is_sigma {
            return Err(Error::BadSigma { view_idx, observation_idx, sigma_px });
        }
    }
    Ok(())
}

fn check(dataset: &Dataset, scene: &Scene) -> Result<(), Error> {
    let counts = [
        ("cameras", scene.rig.cameras.len(), dataset.cameras.len()),
        ("targets", scene.targets.len(), dataset.targets.len()),
        ("frames", scene.rig_from_target.len(), dataset.frames.len()),
    ];
    for (what, found, need) in counts {
        if found != need {
            return Err(Error::SeedMismatch { what, found, need });
        }
    }
    for (view_idx, view) in dataset.views.iter().enumerate() {
        let exists = dataset.cameras.get(view.camera).is_some()
            && dataset.frames.get(view.frame).is_some()
            && dataset.targets.get(view.target).is_some();
        if !exists {
            let (camera, frame, target) = (view.camera, view.frame, view.target);
            return Err(Error::DanglingView { view_idx, camera, frame, target });
        }
    }
    Ok(())
}
