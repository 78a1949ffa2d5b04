//! Views that as a whole do not go with the others: found by their share of outliers, and told apart by
//! the pose that each has for itself.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

use boresight_data::{CameraId, Dataset, Geometry, Target};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::{Elimination, Parameters, Problem, SolveOptions, Term, solve};

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

/// As many views must be displaced alike for the camera to have moved.
const VIEWS_OF_A_MOVE: usize = 3;

/// How much like each other displacements must be, relative to their size.
const ALIKE: f64 = 0.25;

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
    let mut by_camera: Vec<Vec<usize>> = vec![Vec::new(); dataset.cameras.len()];
    for (term_idx, (view_idx, lengths)) in lengths.views.iter().enumerate() {
        let camera = dataset.views[*view_idx].camera.0 as usize;
        n_views[camera] += 1;
        let limit = (sigmas * scales[camera]).max(crate::rejection::ROUNDING_SIGMAS);
        let n_beyond = lengths.iter().filter(|length| **length > limit).count();
        if n_beyond as f64 > SUSPECT_SHARE * lengths.len() as f64 {
            by_camera[camera].push(term_idx);
        }
    }
    let mut reasons = BTreeMap::new();
    for (camera, terms) in by_camera.iter().enumerate() {
        let limit = sigmas * scales[camera];
        let evidence: Vec<(usize, Evidence)> = terms
            .iter()
            .map(|&term_idx| (rig.views[term_idx].0, evidence(dataset, rig, term_idx, limit)))
            .collect();
        let moved = common_displacement(&evidence);
        // A camera that moved may have done so early; anything else that is wrong with half of its views is not in them.
        if moved.is_none() && terms.len() as f64 > BLAMED_SHARE * n_views[camera] as f64 {
            continue;
        }
        for (view_idx, evidence) in &evidence {
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
    let mut layouts = Layouts::default();
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
        let mut term = Reprojection::new(
            camera.model,
            lens,
            shape,
            chain,
            points.clone(),
            &view.observations,
            &mut layouts,
        );
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

/// Returns the displacement `moved_from_cam` that most of a camera's suspect views share.
fn common_displacement(evidence: &[(usize, Evidence)]) -> Option<Pose> {
    let displacements: Vec<Pose> = evidence
        .iter()
        .filter_map(|(_, evidence)| match evidence {
            Evidence::Elsewhere { own, believed } => Some(*own * believed.inverse()),
            _ => None,
        })
        .collect();
    displacements.iter().copied().find(|one| {
        let is_alike = |other: &&Pose| {
            let between = one.inverse() * **other;
            between.angle() <= ALIKE * one.angle().max(1e-3)
                && between.translation.norm() <= ALIKE * one.translation.norm().max(1e-3)
        };
        let n_alike = displacements.iter().filter(is_alike).count();
        n_alike >= VIEWS_OF_A_MOVE && 2 * n_alike > displacements.len()
    })
}

fn describe(evidence: &Evidence, target: &Target, moved: Option<&Pose>, is_shared: bool) -> String {
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
    if let Some(moved) = moved {
        let displacement = *own * believed.inverse();
        let between = moved.inverse() * displacement;
        if between.translation.norm() <= ALIKE * moved.translation.norm().max(1e-3) {
            return format!(
                "its camera stood elsewhere in the rig, by {:.1} mm and {:.2} degrees: it moved between frames",
                1e3 * moved.inverse().translation.norm(),
                moved.angle().to_degrees()
            );
        }
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
    let is_seen = |is_of: &dyn Fn(&boresight_data::View) -> bool| {
        rig.views.iter().any(|(view_idx, _)| is_of(&dataset.views[*view_idx]))
    };
    for frame in dataset.frames.ids() {
        if let Some(block) = rig.frames[frame]
            && !is_seen(&|view| view.frame == frame)
        {
            rig.parameters.hold_all(block);
            rig.frames[frame] = None;
        }
    }
    for target in dataset.targets.ids() {
        if !is_seen(&|view| view.target == target) {
            let blocks = rig.targets[target];
            blocks
                .shape
                .into_iter()
                .chain(blocks.first_from_target)
                .for_each(|block| rig.parameters.hold_all(block));
        }
    }
    let unseen = |camera: CameraId| !is_seen(&|view| view.camera == camera);
    for camera in dataset.cameras.ids().filter(|camera| unseen(*camera)) {
        if let Some(blocks) = rig.cameras[camera] {
            rig.parameters.hold_all(blocks.lens);
            rig.parameters.hold_all(blocks.cam_from_rig);
        }
    }
}
