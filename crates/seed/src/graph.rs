//! Cameras and targets, connected by the frames in which they met.
//!
//! Every edge is a relative pose with a strength. Cameras are joined by a maximum spanning tree, so
//! that each hangs on by the strongest ties there are.

use std::collections::BTreeMap;

use boresight_data::{CameraId, Dataset, FrameId, Id as _, IdVec, TargetId};
use boresight_geometry::Pose;

use crate::average::average;
use crate::hand_eye::{Method, PosePair, hand_eye};

/// A view's pose as the graph needs it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Meeting {
    pub camera: CameraId,
    pub frame: FrameId,
    pub target: TargetId,
    pub cam_from_target: Pose,
    /// The number of points seen.
    pub points: usize,
}

/// Where cameras and targets are, relative to the first camera and the first target of a group.
#[derive(Clone, Debug, Default)]
pub(crate) struct Arrangement {
    pub cam_from_rig: IdVec<CameraId, Option<Pose>>,
    pub first_from_target: IdVec<TargetId, Option<Pose>>,
}

/// Arranges the largest group of connected cameras; those of other groups stay `None`.
pub(crate) fn arrange(dataset: &Dataset, meetings: &[Meeting]) -> Arrangement {
    let is_present = |id: CameraId| meetings.iter().any(|meeting| meeting.camera == id);
    let mut best = Arrangement::default();
    let mut best_rank = (0, 0);
    let mut tried = vec![false; dataset.cameras.len()];
    for root in dataset.cameras.ids() {
        if tried[root.index()] || !is_present(root) {
            continue;
        }
        let arrangement = arrange_around(dataset, meetings, root);
        let (mut cameras, mut points) = (0, 0);
        for (id, pose) in arrangement.cam_from_rig.enumerate() {
            if pose.is_some() {
                tried[id.index()] = true;
                cameras += 1;
                let seen = meetings.iter().filter(|meeting| meeting.camera == id);
                points += seen.map(|meeting| meeting.points).sum::<usize>();
            }
        }
        if (cameras, points) > best_rank {
            best_rank = (cameras, points);
            best = arrangement;
        }
    }
    best
}

/// Arranges all that is connected to the camera `root`, which becomes the rig's frame.
fn arrange_around(dataset: &Dataset, meetings: &[Meeting], root: CameraId) -> Arrangement {
    let mut arrangement = Arrangement {
        cam_from_rig: dataset.cameras.ids().map(|_| None).collect(),
        first_from_target: dataset.targets.ids().map(|_| None).collect(),
    };
    arrangement.cam_from_rig[root] = Some(Pose::identity());
    let first_seen =
        meetings.iter().filter(|meeting| meeting.camera == root).map(|meeting| meeting.target).min();
    if let Some(first) = first_seen {
        arrangement.first_from_target[first] = Some(Pose::identity());
    }
    // Targets make cameras reachable and the other way round; each pass adds all of one kind. Only what is left over is
    // placed by motion, which is known less well.
    loop {
        let added_cameras = add_cameras(&mut arrangement, meetings);
        let added_targets = add_targets(&mut arrangement, meetings);
        if !added_cameras && !added_targets && !add_by_motion(&mut arrangement, meetings) {
            break;
        }
    }
    // The scene is told from the dataset's first target where that one is connected.
    if let Some(rebase_from_target) =
        dataset.targets.ids().next().and_then(|first| arrangement.first_from_target[first])
    {
        let rebase = rebase_from_target.inverse();
        for pose in arrangement.first_from_target.iter_mut().flatten() {
            *pose = rebase * *pose;
        }
    }
    arrangement
}

/// Adds cameras by a maximum spanning tree (Prim) over frames shared on targets already placed.
fn add_cameras(arrangement: &mut Arrangement, meetings: &[Meeting]) -> bool {
    let edges = camera_edges(arrangement, meetings);
    let mut has_added = false;
    loop {
        let mut strongest: Option<(CameraId, &Edge, Pose)> = None;
        for (&(placed, new), edge) in &edges {
            let Some(placed_from_rig) = arrangement.cam_from_rig[placed] else { continue };
            let is_stronger = strongest.as_ref().is_none_or(|(_, best, _)| edge.strength > best.strength);
            if arrangement.cam_from_rig[new].is_none() && is_stronger {
                strongest = Some((new, edge, placed_from_rig));
            }
        }
        let Some((new, edge, placed_from_rig)) = strongest else { return has_added };
        let Some(new_from_placed) = average(&edge.estimates, edge.length_m) else { return has_added };
        arrangement.cam_from_rig[new] = Some(new_from_placed * placed_from_rig);
        has_added = true;
    }
}

/// What ties one camera to another.
#[derive(Default)]
struct Edge {
    /// Per shared frame, the pose of the first camera in the second, and its weight.
    estimates: Vec<(Pose, f64)>,
    strength: f64,
    length_m: f64,
}

/// The fewest frames that place a camera and a target by motion.
const MIN_MOVED_FRAMES: usize = 4;

/// Adds the camera and the target, neither of them placed, that met in most of the frames that are placed.
///
/// What a placed camera sees of a placed target moves as the new camera sees the new target move. That determines both
/// of their places, as hand-eye calibration does: `first_from_rig rig_from_camera camera_from_target` is the same in
/// every frame, where frames are turned about different axes.
fn add_by_motion(arrangement: &mut Arrangement, meetings: &[Meeting]) -> bool {
    let mut rig_from_first: BTreeMap<FrameId, (usize, Pose)> = BTreeMap::new();
    for meeting in meetings {
        let places =
            (arrangement.cam_from_rig[meeting.camera], arrangement.first_from_target[meeting.target]);
        let (Some(cam_from_rig), Some(first_from_target)) = places else { continue };
        let pose = cam_from_rig.inverse() * meeting.cam_from_target * first_from_target.inverse();
        let best = rig_from_first.entry(meeting.frame).or_insert((meeting.points, pose));
        if meeting.points > best.0 {
            *best = (meeting.points, pose);
        }
    }
    let mut pairs: BTreeMap<(CameraId, TargetId), Vec<PosePair>> = BTreeMap::new();
    for meeting in meetings {
        let is_new = arrangement.cam_from_rig[meeting.camera].is_none()
            && arrangement.first_from_target[meeting.target].is_none();
        if let (true, Some((_, rig_from_first))) = (is_new, rig_from_first.get(&meeting.frame)) {
            pairs.entry((meeting.camera, meeting.target)).or_default().push(PosePair {
                other_from_carrier: rig_from_first.inverse(),
                rig_from_target: meeting.cam_from_target,
            });
        }
    }
    let mut candidates: Vec<_> =
        pairs.into_iter().filter(|(_, pairs)| pairs.len() >= MIN_MOVED_FRAMES).collect();
    candidates.sort_by_key(|(_, pairs)| std::cmp::Reverse(pairs.len()));
    for ((camera, target), pairs) in candidates {
        if let Some(found) = hand_eye(&pairs, Method::Shah) {
            arrangement.cam_from_rig[camera] = Some(found.carrier_from_rig.inverse());
            arrangement.first_from_target[target] = Some(found.other_from_target);
            return true;
        }
    }
    false
}

/// Returns the ties of all ordered pairs of cameras.
fn camera_edges(arrangement: &Arrangement, meetings: &[Meeting]) -> BTreeMap<(CameraId, CameraId), Edge> {
    let mut by_frame: BTreeMap<FrameId, Vec<(CameraId, Pose, usize)>> = BTreeMap::new();
    for meeting in meetings {
        if let Some(first_from_target) = arrangement.first_from_target[meeting.target] {
            let cam_from_first = meeting.cam_from_target * first_from_target.inverse();
            by_frame.entry(meeting.frame).or_default().push((meeting.camera, cam_from_first, meeting.points));
        }
    }
    let mut edges: BTreeMap<(CameraId, CameraId), Edge> = BTreeMap::new();
    for seen in by_frame.values() {
        for (from, from_first, from_points) in seen {
            for (to, to_first, to_points) in seen {
                if from == to {
                    continue;
                }
                let edge = edges.entry((*from, *to)).or_default();
                // A relative pose is as good as the poorer of the two views.
                let weight = (*from_points.min(to_points)) as f64;
                edge.estimates.push((*to_first * from_first.inverse(), weight));
                edge.strength += weight;
                edge.length_m += weight * from_first.translation.norm();
            }
        }
    }
    for edge in edges.values_mut() {
        edge.length_m = (edge.length_m / edge.strength).max(f64::MIN_POSITIVE);
    }
    edges
}

/// Adds targets that were seen in a frame together with one already placed, by placed cameras.
fn add_targets(arrangement: &mut Arrangement, meetings: &[Meeting]) -> bool {
    let mut rig_from: BTreeMap<FrameId, Vec<(TargetId, Pose, usize)>> = BTreeMap::new();
    for meeting in meetings {
        if let Some(cam_from_rig) = arrangement.cam_from_rig[meeting.camera] {
            let rig_from_target = cam_from_rig.inverse() * meeting.cam_from_target;
            rig_from.entry(meeting.frame).or_default().push((
                meeting.target,
                rig_from_target,
                meeting.points,
            ));
        }
    }
    let mut estimates: BTreeMap<TargetId, Vec<(Pose, f64)>> = BTreeMap::new();
    let mut length_m: f64 = 0.0;
    for seen in rig_from.values() {
        for (placed, rig_from_placed, placed_points) in seen {
            let Some(first_from_placed) = arrangement.first_from_target[*placed] else { continue };
            for (new, rig_from_new, new_points) in seen {
                if arrangement.first_from_target[*new].is_none() {
                    let first_from_new = first_from_placed * rig_from_placed.inverse() * *rig_from_new;
                    let weight = (*placed_points.min(new_points)) as f64;
                    estimates.entry(*new).or_default().push((first_from_new, weight));
                    length_m = length_m.max(rig_from_new.translation.norm());
                }
            }
        }
    }
    let mut has_added = false;
    for (new, estimates) in estimates {
        if let Some(first_from_new) = average(&estimates, length_m.max(f64::MIN_POSITIVE)) {
            arrangement.first_from_target[new] = Some(first_from_new);
            has_added = true;
        }
    }
    has_added
}
