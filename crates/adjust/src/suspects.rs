//! Views that as a whole do not go with the others: found by their share of outliers, and told apart by
//! the pose that each has for itself.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;
use std::sync::Arc;

use boresight_data::{CameraId, Dataset, FrameId, Geometry, Target, TargetId};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::{BlockId, Elimination, Parameters, Problem, SolveOptions, Term, solve};

use crate::chain::{Chain, Link};
use crate::options::Loss;
use crate::rejection::{Lengths, median};
use crate::reprojection::{Layouts, Reprojection, TargetPoints};
use crate::rig_problem::RigProblem;

/// A view with a larger share of outliers is suspect as a whole.
const SUSPECT_SHARE: f64 = 0.5;

/// If a larger share of a camera's views is suspect, the lens model is to blame and not the views.
const BLAMED_SHARE: f64 = 0.4;

/// A shift of the corners is a multiple of half a square to within this share of a square.
const SHIFT_TOLERANCE_SQUARES: f64 = 0.12;

/// Poses this near in rotation have the same orientation, in radians.
const SAME_ORIENTATION_RAD: f64 = 0.03;

/// Two views of a frame that are turned against each other by less, in radians, may change sides.
const SLIGHT_TURN_RAD: f64 = 0.1;

/// As many views must be displaced alike for the camera to have moved.
const VIEWS_OF_A_MOVE: usize = 3;

/// How much like each other displacements must be, relative to their size.
const ALIKE: f64 = 0.35;

/// What a suspect view's own pose says.
enum Evidence {
    /// The corners fit no pose.
    NoPose,
    /// They fit, but at another pose than that of the rig and the frame: both are `cam_from_target`.
    Elsewhere { own: Pose, believed: Pose },
    /// They fit and nothing tells them from the others but their scatter.
    Scatter,
}

/// Returns the views to leave out, each with the reason.
pub(crate) fn suspects(
    dataset: &Dataset,
    rig: &RigProblem,
    lengths: &Lengths,
    scales: &[f64],
    sigmas: f64,
) -> BTreeMap<usize, String> {
    let mut n_views = vec![0; dataset.cameras.len()];
    let mut suspect = BTreeMap::new();
    for (term_idx, (view_idx, lengths)) in lengths.views.iter().enumerate() {
        let camera = dataset.views[*view_idx].camera.0 as usize;
        n_views[camera] += 1;
        let limit = (sigmas * scales[camera]).max(crate::rejection::ROUNDING_SIGMAS);
        let n_beyond = lengths.iter().filter(|length| **length > limit).count();
        if n_beyond as f64 > SUSPECT_SHARE * lengths.len() as f64 {
            suspect.insert(*view_idx, (term_idx, limit));
        }
    }
    let mut by_camera: Vec<Vec<(usize, Evidence)>> = dataset.cameras.iter().map(|_| Vec::new()).collect();
    for &(term_idx, limit) in suspect.values() {
        let evidence = evidence(dataset, rig, term_idx, limit);
        let is_suspect = |view_idx: usize| suspect.contains_key(&view_idx);
        let (view_idx, evidence) = blamed(dataset, rig, is_suspect, term_idx, evidence);
        by_camera[dataset.views[view_idx].camera.0 as usize].push((view_idx, evidence));
    }
    let mut reasons = BTreeMap::new();
    for (camera, evidence) in by_camera.iter().enumerate() {
        let moved = common_move(dataset, evidence);
        // A camera that moved may have done so early; anything else that is wrong with half of its views is not in them.
        if moved.is_none() && evidence.len() as f64 > BLAMED_SHARE * n_views[camera] as f64 {
            continue;
        }
        for (view_idx, evidence) in evidence {
            let view = &dataset.views[*view_idx];
            let is_shared = rig.views.iter().any(|(other, _)| {
                let other = &dataset.views[*other];
                other.frame == view.frame && other.camera != view.camera
            });
            let reason = describe(evidence, &dataset.targets[view.target], moved.as_ref(), is_shared);
            reasons.insert(*view_idx, reason);
        }
    }
    reasons
}

/// Fits a pose of its own to a view, from where it is believed and from its turned and flipped likenesses.
fn evidence(dataset: &Dataset, rig: &RigProblem, term_idx: usize, limit_sigmas: f64) -> Evidence {
    let (view_idx, term) = &rig.views[term_idx];
    let view = &dataset.views[*view_idx];
    let target = &dataset.targets[view.target];
    let values = rig.parameters.values();
    let believed = term.cam_from_target(values);
    let Some(camera) = rig.cameras[view.camera] else { return Evidence::NoPose };
    let centre = centre_of(target);
    let turned = |rotation_vector: Vector3<f64>| {
        let turn = Pose::from_rodrigues(rotation_vector, Vector3::zeros());
        believed * Pose::new(turn.rotation, centre - turn.rotation * centre)
    };
    let starts = [
        believed,
        turned(Vector3::z() * PI),
        turned(Vector3::x() * PI),
        turned(Vector3::y() * PI),
        turned(Vector3::z() * (0.5 * PI)),
        turned(Vector3::z() * (-0.5 * PI)),
    ];
    let points = Arc::new(TargetPoints::new(target, &view.observations));
    let shape = rig.targets[view.target].shape;
    let layouts = Layouts::default();
    let mut best: Option<(f64, Pose)> = None;
    for start in starts {
        let mut parameters = Parameters::default();
        let lens = parameters.add_vector(values.vector(camera.lens));
        parameters.hold_all(lens);
        let shape = shape.map(|block| {
            let coefficients = values.vector(block);
            let block = parameters.add_vector(coefficients);
            parameters.hold_all(block);
            (block, coefficients.len())
        });
        let pose = parameters.add_pose(&start, Elimination::First);
        let chain = Chain { links: vec![Link::Block(pose)] };
        let mut term =
            Reprojection::new(camera.model, lens, shape, chain, points.clone(), &view.observations, &layouts);
        // From far away the loss must not let go of anything.
        for loss in [Loss::None, Loss::Cauchy { sigmas: limit_sigmas.max(1e-9) }] {
            term.set_loss(loss);
            let solution = Problem::new(&parameters, vec![&term as &dyn Term])
                .and_then(|problem| solve(&problem, &SolveOptions { threads: 1, ..SolveOptions::default() }));
            match solution {
                Ok(solution) => parameters.set_values(&solution.values),
                Err(_) => break,
            }
        }
        let predictions = term.predict(parameters.values());
        let mut lengths: Vec<f64> = predictions
            .iter()
            .zip(&view.observations)
            .map(|(prediction, seen)| {
                prediction.map_or(f64::INFINITY, |[u, v]| {
                    (u - seen.pixel[0]).hypot(v - seen.pixel[1]) / seen.sigma_px
                })
            })
            .collect();
        let typical = median(&mut lengths);
        if best.is_none_or(|(least, _)| typical < least) {
            best = Some((typical, parameters.values().pose(pose)));
        }
        if typical <= 0.5 * limit_sigmas {
            break;
        }
    }
    match best {
        Some((typical, own)) if typical <= limit_sigmas => {
            let offset = believed.inverse() * own;
            let gap = (offset * centre - centre).norm();
            let is_here = offset.angle() < 0.1 * SAME_ORIENTATION_RAD && gap < 1e-3 * own.translation.norm();
            if is_here { Evidence::Scatter } else { Evidence::Elsewhere { own, believed } }
        }
        _ => Evidence::NoPose,
    }
}

/// Returns which view is to blame for what was found of a suspect one, and what that says of it.
///
/// Where just two cameras see the target and disagree a little, nothing tells which of them is right. So that
/// frames agree on it, the one that comes first is, as it is the reference where it has the choice.
fn blamed(
    dataset: &Dataset,
    rig: &RigProblem,
    is_suspect: impl Fn(usize) -> bool,
    term_idx: usize,
    evidence: Evidence,
) -> (usize, Evidence) {
    let view_idx = rig.views[term_idx].0;
    let Evidence::Elsewhere { own, believed } = evidence else { return (view_idx, evidence) };
    let view = &dataset.views[view_idx];
    let mut others =
        rig.views.iter().filter(|(idx, _)| *idx != view_idx && dataset.views[*idx].frame == view.frame);
    if let (Some((other_idx, other_term)), None) = (others.next(), others.next()) {
        let other = &dataset.views[*other_idx];
        let is_slight = (believed.inverse() * own).angle() < SLIGHT_TURN_RAD;
        if is_slight
            && other.camera.0 > view.camera.0
            && other.target == view.target
            && !is_suspect(*other_idx)
        {
            let own_of_other = other_term.cam_from_target(rig.parameters.values());
            let other_from_this = own_of_other * believed.inverse();
            return (*other_idx, Evidence::Elsewhere { own: own_of_other, believed: other_from_this * own });
        }
    }
    (view_idx, Evidence::Elsewhere { own, believed })
}

/// How a camera moved in the rig.
struct Move {
    moved_from_cam: Pose,
    /// How far it takes the target that told of it, in metres.
    size_m: f64,
}

impl Move {
    /// Tells whether it explains where a view has the centre of its target.
    ///
    /// The turn of a single view's pose is not known so well that it could be compared elsewhere.
    fn explains(&self, own: &Pose, believed: &Pose, centre: &Vector3<f64>) -> bool {
        let (seen, expected) = (*own * *centre, *believed * *centre);
        let size_m = (seen - expected).norm().max(self.size_m).max(1e-3);
        (self.moved_from_cam * expected - seen).norm() <= ALIKE * size_m
    }
}

/// Returns the move of a camera that explains most of its suspect views.
fn common_move(dataset: &Dataset, evidence: &[(usize, Evidence)]) -> Option<Move> {
    let elsewhere: Vec<(Pose, Pose, Vector3<f64>)> = evidence
        .iter()
        .filter_map(|(view_idx, evidence)| match evidence {
            Evidence::Elsewhere { own, believed } => {
                Some((*own, *believed, centre_of(&dataset.targets[dataset.views[*view_idx].target])))
            }
            _ => None,
        })
        .collect();
    let mut best: Option<(usize, Move)> = None;
    for (own, believed, centre) in &elsewhere {
        let size_m = (*own * *centre - *believed * *centre).norm();
        let one = Move { moved_from_cam: *own * believed.inverse(), size_m };
        let n_explained =
            elsewhere.iter().filter(|(own, believed, centre)| one.explains(own, believed, centre)).count();
        if best.as_ref().is_none_or(|(most, _)| n_explained > *most) {
            best = Some((n_explained, one));
        }
    }
    best.filter(|(n, _)| *n >= VIEWS_OF_A_MOVE && 2 * n > elsewhere.len()).map(|(_, found)| found)
}

fn describe(evidence: &Evidence, target: &Target, moved: Option<&Move>, is_shared: bool) -> String {
    let (own, believed) = match evidence {
        Evidence::NoPose => {
            return "most of its corners fit the target at no pose: they are in another order, of another target, or wrong"
                .to_owned();
        }
        Evidence::Scatter => {
            return "most of its corners scatter beyond the limit: the image may be blurred or the board in motion".to_owned();
        }
        Evidence::Elsewhere { own, believed } => (own, believed),
    };
    let offset = believed.inverse() * *own;
    let centre = centre_of(target);
    if offset.angle() > 0.5 * PI - 0.3 {
        return format!(
            "its corners are counted from another corner of the board: they fit it turned by {:.0} degrees",
            offset.angle().to_degrees()
        );
    }
    if let Some(moved) = moved.filter(|moved| moved.explains(own, believed, &centre)) {
        let moved_from_cam = &moved.moved_from_cam;
        return format!(
            "its camera stood elsewhere in the rig, by {:.1} mm and {:.2} degrees: it moved between frames",
            1e3 * moved_from_cam.inverse().translation.norm(),
            moved_from_cam.angle().to_degrees()
        );
    }
    if let Geometry::Chessboard { spacing_m, .. } = target.geometry
        && offset.angle() < SAME_ORIENTATION_RAD
    {
        let shift = (offset * centre - centre) / spacing_m;
        let nearest = shift.map(|squares| 0.5 * (2.0 * squares).round());
        let is_multiple = (shift - nearest).amax() < SHIFT_TOLERANCE_SQUARES;
        if is_multiple && nearest.amax() >= 0.5 && nearest.z == 0.0 {
            return format!(
                "its corners are shifted by {} and {} squares along x and y against the other cameras'",
                // Zero without a sign.
                nearest.x + 0.0,
                nearest.y + 0.0
            );
        }
    }
    let distance_mm = 1e3 * (*own * centre - *believed * centre).norm();
    if is_shared {
        format!(
            "its camera saw the target {distance_mm:.1} mm from where the others did: not at the same time, or not the same target"
        )
    } else {
        format!("it fits a pose {distance_mm:.1} mm from the one believed")
    }
}

/// Returns the middle of a target's drawn points, in its frame.
fn centre_of(target: &Target) -> Vector3<f64> {
    let n_points = target.point_count();
    let sum: Vector3<f64> =
        (0..n_points).map(|point| target.drawn_point(boresight_data::PointId(point as u32))).sum();
    sum / n_points.max(1) as f64
}

/// Takes views out of a problem; what nothing sees any more is held.
pub(crate) fn leave_out(rig: &mut RigProblem, dataset: &Dataset, reasons: &BTreeMap<usize, String>) {
    rig.views.retain(|(view_idx, _)| !reasons.contains_key(view_idx));
    let views = || rig.views.iter().map(|(view_idx, _)| &dataset.views[*view_idx]);
    let frames: BTreeSet<FrameId> = views().map(|view| view.frame).collect();
    let targets: BTreeSet<TargetId> = views().map(|view| view.target).collect();
    let cameras: BTreeSet<CameraId> = views().map(|view| view.camera).collect();
    // Of a camera that shares its lens with one that is left, only the pose is held.
    let lenses: BTreeSet<BlockId> =
        cameras.iter().filter_map(|&camera| Some(rig.cameras[camera]?.lens)).collect();
    for frame in dataset.frames.ids().filter(|frame| !frames.contains(frame)) {
        if let Some(block) = rig.frames[frame].take() {
            rig.parameters.hold_all(block);
        }
    }
    for target in dataset.targets.ids().filter(|target| !targets.contains(target)) {
        let blocks = rig.targets[target];
        for block in blocks.shape.into_iter().chain(blocks.first_from_target) {
            rig.parameters.hold_all(block);
        }
    }
    for camera in dataset.cameras.ids().filter(|camera| !cameras.contains(camera)) {
        let Some(blocks) = rig.cameras[camera] else { continue };
        if !lenses.contains(&blocks.lens) {
            rig.parameters.hold_all(blocks.lens);
        }
        rig.parameters.hold_all(blocks.cam_from_rig);
        blocks.late.into_iter().for_each(|late| rig.parameters.hold_all(late));
    }
}
