//! Cameras, targets and frames refined together, with the lenses held.
//!
//! One reprojection serves every topology: `cam_from_target = cam_from_rig * rig_from_first *
//! first_from_target`. A view is differentiated once, by the left perturbation of the composite
//! pose, and adjoints map that to each link of the chain. Frames are eliminated by Schur complement.

use boresight_data::{CameraId, FrameId, Id as _, IdVec, TargetId};
use boresight_geometry::nalgebra::{Cholesky, DMatrix, DVector};
use boresight_geometry::{Matrix6, Pose, Vector6};

use crate::graph::Arrangement;
use crate::kernel::{Cost, Lens, PoseSum, pose_sum};
use crate::linear::exceeds;
use crate::rig::places;
use crate::robust::{median, width_for};
use crate::sighting::Sighting;

/// Frames per camera that the arrangement is refined on.
const FRAMES_PER_CAMERA: usize = 24;
const RIG_STEPS: usize = 8;
const FRAME_STEPS: usize = 4;

/// A view as a link between a camera, a frame and a target.
#[derive(Clone, Debug)]
pub(crate) struct Link<'a> {
    pub camera: CameraId,
    pub frame: FrameId,
    pub target: TargetId,
    pub lens: Lens<'a>,
    pub sighting: &'a Sighting,
    /// The pose that the view alone asks for.
    pub cam_from_target: Pose,
    /// The usual median length of the camera's residuals, in sigmas.
    pub typical: f64,
}

impl Link<'_> {
    /// Returns the pose of the first target in the rig that this view alone asks for.
    pub fn rig_from_first(&self, arrangement: &Arrangement) -> Option<Pose> {
        let (cam_from_rig, first_from_target) = places(arrangement, self.camera, self.target)?;
        Some(cam_from_rig.inverse() * self.cam_from_target * first_from_target.inverse())
    }

    /// Returns the composite pose for a pose of the frame.
    pub fn cam_from_target_at(&self, rig_from_first: &Pose, arrangement: &Arrangement) -> Option<Pose> {
        let (cam_from_rig, first_from_target) = places(arrangement, self.camera, self.target)?;
        Some(cam_from_rig * *rig_from_first * first_from_target)
    }
}

/// Refines the pose of one frame over all its views by damped Gauss-Newton; `None` if nothing projects.
pub(crate) fn refine_frame(links: &[Link<'_>], arrangement: &Arrangement, start: &Pose) -> Option<Pose> {
    let mut pose = *start;
    let mut lengths = Vec::new();
    let sum_at = |pose: &Pose, width: f64, lengths: &mut Vec<f64>| {
        lengths.clear();
        let (mut hessian, mut gradient, mut cost) = (Matrix6::zeros(), Vector6::zeros(), Cost::default());
        for link in links {
            let (cam_from_rig, first_from_target) = places(arrangement, link.camera, link.target)?;
            let composite = cam_from_rig * *pose * first_from_target;
            let sum = pose_sum(link.lens, &composite, link.sighting, width, lengths);
            let adjoint = cam_from_rig.adjoint();
            hessian += adjoint.transpose() * sum.hessian * adjoint;
            gradient += adjoint.transpose() * sum.gradient;
            cost += sum.cost;
        }
        Some((hessian, gradient, cost))
    };
    let floor = width_for(links.iter().map(|link| link.typical).fold(0.0, f64::max));
    let mut width = 4.0 * floor;
    let mut current = sum_at(&pose, width, &mut lengths)?;
    if lengths.is_empty() {
        return None;
    }
    let mut damping = 1e-7;
    for _ in 0..FRAME_STEPS {
        let (hessian, gradient, cost) = current;
        let mut damped = hessian;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let Some(factor) = Cholesky::new(damped) else { break };
        let step = -factor.solve(&gradient);
        if !exceeds(-step.dot(&gradient), 1e-4 * cost.loss) {
            break;
        }
        let trial = pose.perturbed(&step);
        let mut trial_lengths = Vec::with_capacity(lengths.len());
        let next = sum_at(&trial, width, &mut trial_lengths)?;
        if next.2.is_below(&cost) {
            (pose, current, lengths) = (trial, next, trial_lengths);
            damping *= 0.1;
            width = width_for(median(&lengths)).clamp(floor, width);
            current.2 = Cost::of(&lengths, current.2.outside, width);
        } else {
            damping = (damping * 30.0).max(1e-4);
        }
    }
    Some(pose)
}

/// One linearisation over the chosen frames.
struct Linearized {
    sums: Vec<Vec<PoseSum>>,
    lengths: Vec<f64>,
    cost: Cost,
}

/// Refines the poses of cameras and targets, on a choice of frames whose poses are refined with them.
pub(crate) fn refine_rig(
    frames: &IdVec<FrameId, Vec<Link<'_>>>,
    arrangement: &mut Arrangement,
    rig_from_target: &mut IdVec<FrameId, Option<Pose>>,
) {
    let columns = Columns::of(arrangement);
    let chosen = choose_frames(frames, rig_from_target, arrangement.cam_from_rig.len());
    if columns.count == 0 || chosen.is_empty() {
        return;
    }
    let mut poses: Vec<Pose> = chosen.iter().filter_map(|&frame| rig_from_target[frame]).collect();
    let linearize = |arrangement: &Arrangement, poses: &[Pose], width: f64| -> Option<Linearized> {
        let (mut lengths, mut cost) = (Vec::new(), Cost::default());
        let mut sums = Vec::with_capacity(chosen.len());
        for (&frame, pose) in chosen.iter().zip(poses) {
            let mut of_frame = Vec::with_capacity(frames[frame].len());
            for link in &frames[frame] {
                let composite = link.cam_from_target_at(pose, arrangement)?;
                let sum = pose_sum(link.lens, &composite, link.sighting, width, &mut lengths);
                cost += sum.cost;
                of_frame.push(sum);
            }
            sums.push(of_frame);
        }
        Some(Linearized { sums, lengths, cost })
    };
    let Some(first) = linearize(arrangement, &poses, 1e6) else { return };
    let mut width = width_for(median(&first.lengths));
    let Some(mut current) = linearize(arrangement, &poses, width) else { return };
    let mut damping = 1e-6;
    for _ in 0..RIG_STEPS {
        let system = System { frames, chosen: &chosen, columns: &columns };
        let Some((step, frame_steps)) = system.solve(&current.sums, arrangement, &poses, damping) else {
            damping = (damping * 30.0).max(1e-4);
            continue;
        };
        let trial = columns.moved(arrangement, &step);
        let moved: Vec<Pose> =
            poses.iter().zip(&frame_steps).map(|(pose, step)| pose.perturbed(step)).collect();
        let Some(next) = linearize(&trial, &moved, width) else { return };
        if !next.cost.is_below(&current.cost) {
            damping = (damping * 30.0).max(1e-4);
            continue;
        }
        let next_width = width_for(median(&next.lengths)).min(width);
        let is_done = next.cost.loss > 0.995 * current.cost.loss && next_width > 0.99 * width;
        (*arrangement, poses, current) = (trial, moved, next);
        damping = (damping * 0.1).max(1e-9);
        width = next_width;
        current.cost = Cost::of(&current.lengths, current.cost.outside, width);
        if is_done {
            break;
        }
    }
    for (&frame, pose) in chosen.iter().zip(poses) {
        rig_from_target[frame] = Some(pose);
    }
    // The other frames are told anew by the views they have.
}

/// Chooses frames with most views first, until every camera has enough; in increasing order.
fn choose_frames(
    frames: &IdVec<FrameId, Vec<Link<'_>>>,
    rig_from_target: &IdVec<FrameId, Option<Pose>>,
    n_cameras: usize,
) -> Vec<FrameId> {
    let mut order: Vec<FrameId> =
        frames.ids().filter(|&frame| frames[frame].len() > 1 && rig_from_target[frame].is_some()).collect();
    order.sort_by_key(|&frame| (std::cmp::Reverse(frames[frame].len()), frame));
    let mut seen = vec![0; n_cameras];
    let mut chosen = Vec::new();
    for frame in order {
        if frames[frame].iter().any(|link| seen[link.camera.index()] < FRAMES_PER_CAMERA) {
            frames[frame].iter().for_each(|link| seen[link.camera.index()] += 1);
            chosen.push(frame);
        }
    }
    chosen.sort_unstable();
    chosen
}

/// Where the perturbations of cameras and targets stand in the step; the first of each stays.
struct Columns {
    cameras: IdVec<CameraId, Option<usize>>,
    targets: IdVec<TargetId, Option<usize>>,
    count: usize,
}

impl Columns {
    fn of(arrangement: &Arrangement) -> Self {
        let mut count = 0;
        let mut assign = |pose: &Option<Pose>, is_first: &mut bool| {
            pose.as_ref()?;
            if std::mem::take(is_first) {
                return None;
            }
            count += 6;
            Some(count - 6)
        };
        let (mut first_camera, mut first_target) = (true, true);
        let cameras = arrangement.cam_from_rig.iter().map(|pose| assign(pose, &mut first_camera)).collect();
        let targets =
            arrangement.first_from_target.iter().map(|pose| assign(pose, &mut first_target)).collect();
        Self { cameras, targets, count }
    }

    /// Returns the arrangement after a step.
    fn moved(&self, arrangement: &Arrangement, step: &DVector<f64>) -> Arrangement {
        let apply = |pose: &Option<Pose>, column: &Option<usize>| {
            let pose = (*pose)?;
            Some(column.map_or(pose, |column| pose.perturbed(&step.fixed_rows::<6>(column).into_owned())))
        };
        let cameras = arrangement.cam_from_rig.iter().zip(&self.cameras);
        let targets = arrangement.first_from_target.iter().zip(&self.targets);
        Arrangement {
            cam_from_rig: cameras.map(|(pose, column)| apply(pose, column)).collect(),
            first_from_target: targets.map(|(pose, column)| apply(pose, column)).collect(),
        }
    }
}

/// The normal equations' layout.
struct System<'a> {
    frames: &'a IdVec<FrameId, Vec<Link<'a>>>,
    chosen: &'a [FrameId],
    columns: &'a Columns,
}

impl System<'_> {
    /// Returns the damped steps of cameras and targets, and of every frame.
    fn solve(
        &self,
        sums: &[Vec<PoseSum>],
        arrangement: &Arrangement,
        poses: &[Pose],
        damping: f64,
    ) -> Option<(DVector<f64>, Vec<Vector6<f64>>)> {
        let n = self.columns.count;
        let (mut reduced, mut right) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
        let mut eliminated = Vec::with_capacity(poses.len());
        for ((&frame, pose), sums) in self.chosen.iter().zip(poses).zip(sums) {
            let (mut frame_hessian, mut frame_gradient) = (Matrix6::zeros(), Vector6::zeros());
            let mut couplings: Vec<(usize, Matrix6<f64>)> = Vec::new();
            for (link, sum) in self.frames[frame].iter().zip(sums) {
                let (cam_from_rig, _) = places(arrangement, link.camera, link.target)?;
                let by_frame = cam_from_rig.adjoint();
                frame_hessian += by_frame.transpose() * sum.hessian * by_frame;
                frame_gradient += by_frame.transpose() * sum.gradient;
                let by_target = (cam_from_rig * *pose).adjoint();
                let blocks = [
                    (self.columns.cameras[link.camera], Matrix6::identity()),
                    (self.columns.targets[link.target], by_target),
                ];
                let blocks = blocks.iter().filter_map(|(column, by)| Some(((*column)?, by)));
                let blocks: Vec<(usize, &Matrix6<f64>)> = blocks.collect();
                for &(row, by_row) in &blocks {
                    let weighed = by_row.transpose() * sum.hessian;
                    let mut target = right.fixed_rows_mut::<6>(row);
                    target -= by_row.transpose() * sum.gradient;
                    for &(column, by_column) in &blocks {
                        let mut block = reduced.fixed_view_mut::<6, 6>(row, column);
                        block += weighed * by_column;
                    }
                    couplings.push((row, weighed * by_frame));
                }
            }
            for i in 0..6 {
                frame_hessian[(i, i)] *= 1.0 + damping;
            }
            let factor = Cholesky::new(frame_hessian)?;
            let frame_step = -factor.solve(&frame_gradient);
            for (row, coupling) in &couplings {
                let mut target = right.fixed_rows_mut::<6>(*row);
                target -= coupling * frame_step;
                let solved = factor.solve(&coupling.transpose());
                for (column, other) in &couplings {
                    let mut block = reduced.fixed_view_mut::<6, 6>(*column, *row);
                    block -= other * solved;
                }
            }
            eliminated.push((factor, frame_step, couplings));
        }
        for i in 0..n {
            // A camera that meets no other in the chosen frames has no equation here: it stays.
            reduced[(i, i)] = reduced[(i, i)] * (1.0 + damping) + 1e-9;
        }
        let step = Cholesky::new(reduced)?.solve(&right);
        let frame_steps = eliminated.into_iter().map(|(factor, frame_step, couplings)| {
            let mut pull = Vector6::zeros();
            for (row, coupling) in &couplings {
                pull += coupling.transpose() * step.fixed_rows::<6>(*row);
            }
            frame_step - factor.solve(&pull)
        });
        let frame_steps: Vec<Vector6<f64>> = frame_steps.collect();
        step.iter().all(|value| value.is_finite()).then_some((step, frame_steps))
    }
}
