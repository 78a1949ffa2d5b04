//! From calibrated cameras to a scene: who sits where, where the target stood, and what does not fit.

use boresight_data::{
    CameraId, Dataset, FrameId, Id as _, IdVec, Rig, RigCamera, Scene, TargetBelief, TargetId,
};
use boresight_geometry::Pose;

use crate::LeftOut;
use crate::graph::{Arrangement, Meeting, arrange};
use crate::intrinsics::CameraSeed;
use crate::kernel::{Cost, Lens, residual_lengths};
use crate::rig_bundle::{Link, refine_frame, refine_rig};
use crate::robust::{median, width_for};
use crate::sighting::Sighting;

/// The views with most points that are asked where a frame's target stood.
const MAX_CANDIDATES: usize = 4;

/// Builds the scene of the largest connected group; what is not in it goes to the lists of facts.
pub(crate) fn assemble(
    dataset: &Dataset,
    sightings: &[Vec<Sighting>],
    mut cameras: Vec<Option<CameraSeed>>,
    camera_facts: &mut Vec<LeftOut>,
    view_facts: &mut Vec<LeftOut>,
) -> Scene {
    let mut arrangement = arrange(dataset, &meetings(dataset, sightings, &cameras));
    let kept = arrangement.cam_from_rig.iter().flatten().count();
    for id in dataset.cameras.ids() {
        let Some(seeded) = &cameras[id.index()] else { continue };
        if arrangement.cam_from_rig[id].is_none() {
            let views = seeded.resections.iter().flatten().count();
            camera_facts.push(LeftOut::Unconnected { camera: id, views, kept });
            cameras[id.index()] = None;
        }
    }

    let links = links(dataset, sightings, &cameras, &arrangement, view_facts);
    let mut frames: IdVec<FrameId, Vec<Link<'_>>> = dataset.frames.ids().map(|_| Vec::new()).collect();
    for link in links {
        frames[link.frame].push(link);
    }
    let mut rig_from_target: IdVec<FrameId, Option<Pose>> =
        frames.iter().map(|links| best_frame_pose(links, &arrangement)).collect();
    refine_rig(&frames, &mut arrangement, &mut rig_from_target);
    settle_frames(&mut frames, &arrangement, &mut rig_from_target, view_facts);

    let cameras = cameras
        .into_iter()
        .zip(&arrangement.cam_from_rig)
        .map(|(seeded, cam_from_rig)| Some(RigCamera::new(seeded?.camera, (*cam_from_rig)?)));
    let rig = Rig { cameras: cameras.collect() };
    let targets = dataset.targets.enumerate().map(|(id, target)| TargetBelief {
        shape_m: vec![0.0; target.shape.coefficient_count()],
        first_from_target: arrangement.first_from_target[id].unwrap_or_default(),
    });
    Scene { rig, robot: None, targets: targets.collect(), rig_from_target, motion: IdVec::default() }
}

/// Lists the poses of all views that have one.
fn meetings(dataset: &Dataset, sightings: &[Vec<Sighting>], cameras: &[Option<CameraSeed>]) -> Vec<Meeting> {
    let mut meetings = Vec::new();
    for (sightings, seeded) in sightings.iter().zip(cameras) {
        let Some(seeded) = seeded else { continue };
        for (sighting, resection) in sightings.iter().zip(&seeded.resections) {
            let Some(resection) = resection else { continue };
            let view = &dataset.views[sighting.view_idx];
            meetings.push(Meeting {
                camera: view.camera,
                frame: view.frame,
                target: view.target,
                cam_from_target: resection.cam_from_target,
                points: sighting.len(),
            });
        }
    }
    meetings
}

/// Lists the views that tie a placed camera, through a frame, to a placed target.
fn links<'a>(
    dataset: &Dataset,
    sightings: &'a [Vec<Sighting>],
    cameras: &'a [Option<CameraSeed>],
    arrangement: &Arrangement,
    view_facts: &mut Vec<LeftOut>,
) -> Vec<Link<'a>> {
    let mut links = Vec::new();
    for (sightings, seeded) in sightings.iter().zip(cameras) {
        let Some(seeded) = seeded else { continue };
        for (sighting, resection) in sightings.iter().zip(&seeded.resections) {
            let Some(resection) = resection else { continue };
            let view = &dataset.views[sighting.view_idx];
            if arrangement.first_from_target[view.target].is_none() {
                let fact = LeftOut::UnconnectedTarget { view_idx: sighting.view_idx, target: view.target };
                view_facts.push(fact);
                continue;
            }
            links.push(Link {
                camera: view.camera,
                frame: view.frame,
                target: view.target,
                lens: Lens::of(&seeded.camera),
                sighting,
                cam_from_target: resection.cam_from_target,
                typical: seeded.typical,
            });
        }
    }
    links
}

/// Returns the pose of the first target that suits all of a frame's views best, among those which each view asks for.
fn best_frame_pose(links: &[Link<'_>], arrangement: &Arrangement) -> Option<Pose> {
    let mut largest: Vec<&Link<'_>> = links.iter().collect();
    largest.sort_by_key(|link| std::cmp::Reverse(link.sighting.len()));
    largest.truncate(MAX_CANDIDATES);
    let candidates: Vec<Pose> = largest.iter().filter_map(|link| link.rig_from_first(arrangement)).collect();
    if candidates.len() < 2 {
        return candidates.first().copied();
    }
    let judge = |candidate: &Pose| -> Option<(usize, f64)> {
        let (mut loss, mut outside) = (0.0, 0);
        let mut lengths = Vec::new();
        for link in links {
            lengths.clear();
            let cam_from_target = link.cam_from_target_at(candidate, arrangement)?;
            outside += residual_lengths(link.lens, &cam_from_target, link.sighting, &mut lengths);
            // Wide: cameras are only placed roughly yet.
            loss += Cost::of(&lengths, 0, 10.0 * width_for(link.typical)).loss;
        }
        Some((outside, loss))
    };
    let judged = candidates.iter().filter_map(|candidate| Some((judge(candidate)?, *candidate)));
    judged
        .min_by(|((a_outside, a_loss), _), ((b_outside, b_loss), _)| {
            a_outside.cmp(b_outside).then(a_loss.total_cmp(b_loss))
        })
        .map(|(_, pose)| pose)
}

/// Refines every frame's pose over all its views, and leaves out the views that contradict the rest.
fn settle_frames(
    frames: &mut IdVec<FrameId, Vec<Link<'_>>>,
    arrangement: &Arrangement,
    rig_from_target: &mut IdVec<FrameId, Option<Pose>>,
    view_facts: &mut Vec<LeftOut>,
) {
    let mut fits = Vec::new();
    for (links, pose) in frames.iter().zip(rig_from_target.iter_mut()) {
        let Some(start) = *pose else { continue };
        if links.len() > 1 {
            *pose = refine_frame(links, arrangement, &start);
        }
        fits.extend(pose.iter().flat_map(|pose| links.iter().map(|link| fit_of(link, pose, arrangement).0)));
    }
    let usual = median(&fits);
    for (links, pose) in frames.iter_mut().zip(rig_from_target.iter_mut()) {
        // The worst view goes first; without it, the others may fit.
        while let Some(current) = *pose {
            let worst = links
                .iter()
                .enumerate()
                .map(|(i, link)| (i, fit_of(link, &current, arrangement)))
                .max_by(|(_, a), (_, b)| a.1.cmp(&b.1).then(a.0.total_cmp(&b.0)));
            let Some((i, (median_sigmas, outside))) = worst else { break };
            let limit_sigmas = (10.0 * usual.max(links[i].typical)).max(3.0);
            let view_idx = links[i].sighting.view_idx;
            if outside > 0 {
                view_facts.push(LeftOut::OutOfSight { view_idx, points: outside });
            } else if median_sigmas > limit_sigmas {
                view_facts.push(LeftOut::BadFit { view_idx, median_sigmas, limit_sigmas });
            } else {
                break;
            }
            links.remove(i);
            let start = best_frame_pose(links, arrangement);
            *pose = start.and_then(|start| refine_frame(links, arrangement, &start));
        }
    }
}

/// Returns the median residual of a view in sigmas, and how many of its points do not project.
fn fit_of(link: &Link<'_>, rig_from_first: &Pose, arrangement: &Arrangement) -> (f64, usize) {
    let mut lengths = Vec::with_capacity(link.sighting.len());
    match link.cam_from_target_at(rig_from_first, arrangement) {
        Some(cam_from_target) => {
            let outside = residual_lengths(link.lens, &cam_from_target, link.sighting, &mut lengths);
            (median(&lengths), outside)
        }
        None => (f64::INFINITY, link.sighting.len()),
    }
}

/// Returns the places of a camera and a target in the arrangement, if both have one.
pub(crate) fn places(arrangement: &Arrangement, camera: CameraId, target: TargetId) -> Option<(Pose, Pose)> {
    Some((arrangement.cam_from_rig[camera]?, arrangement.first_from_target[target]?))
}
