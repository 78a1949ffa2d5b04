//! Cameras that hang on few frames.

use std::collections::{BTreeMap, BTreeSet};

use boresight_data::{CameraId, FrameId, Severity};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};

/// Fewer shared frames than this leave no room for a bad one.
const CAUTION_BELOW: usize = 4;

/// Cameras that hang on few frames.
pub(super) struct WeakRigLink;

impl Diagnostic for WeakRigLink {
    const CODE: &'static str = "weak-rig-link";

    const EXPLANATION: &'static str = "\
What it means: in fewer than four frames did this camera, or this group of
cameras, and any other camera of the rig see a target at the same time. Cameras
of a group may be linked well among themselves.

Why it matters: where cameras sit relative to each other is known from shared
frames alone. With one to three of them, the pose across that gap rests on a
handful of board poses, each as good as a single view can give, and one bad
image is enough to turn part of the rig by a degree. Nothing shows in the
residuals, because nothing else contradicts it. The intrinsics are not affected.

How to fix it: take frames in which the named camera and one of the others see
the board at once; ten or more, at different places and tilts. Where the fields
of view barely overlap, use a larger board, partial boards, several boards that
are fixed to each other, or walk around so that every camera is linked through
its neighbours.";

    fn find(case: &Case) -> Vec<Found> {
        let cameras: Vec<(CameraId, &str)> = case.cameras().map(|(id, name, _)| (id, name)).collect();
        let weak = gaps(case, &cameras).into_iter().filter_map(|(side, n_shared)| {
            (n_shared < CAUTION_BELOW).then(|| {
                let names = cameras.iter().filter(|(id, _)| side.contains(id)).map(|(_, name)| *name);
                let place = names.collect::<Vec<_>>().join(", ");
                Found {
                    severity: Severity::Caution,
                    message: format!(
                        "only {} shared with the other cameras of the rig",
                        if n_shared == 1 {
                            "1 frame is".to_owned()
                        } else {
                            count(n_shared, "frame") + " are"
                        }
                    ),
                    measured: Some(n_shared as f64),
                    limit: Some(CAUTION_BELOW as f64),
                    fix: format!(
                        "Take ten frames in which {place} and another camera see the board at once."
                    ),
                    place,
                }
            })
        });
        weak.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let with = |n_shared: u32| {
            let mut example = Example::stereo();
            let frame_of: Vec<_> =
                example.dataset.views.iter().map(|view| (view.frame, view.camera)).collect();
            // Beyond the first frames, the cameras take turns.
            example.retain_views(|i| frame_of[i].0.0 < n_shared || frame_of[i].0.0 % 2 == frame_of[i].1.0);
            example
        };
        vec![(with(0), Severity::Caution), (with(3), Severity::Caution)]
    }
}

/// Returns the cameras that hang on the others by the fewest frames, and how many these are; `None` for a single camera.
pub(crate) fn weakest_link(case: &Case) -> Option<(Vec<CameraId>, usize)> {
    let cameras: Vec<(CameraId, &str)> = case.cameras().map(|(id, name, _)| (id, name)).collect();
    let weakest = gaps(case, &cameras).into_iter().min_by_key(|(_, n_shared)| *n_shared);
    weakest.map(|(side, n_shared)| (side.into_iter().collect(), n_shared))
}

/// Returns the cameras on the smaller side of each link that holds the rig together, with how many frames cross it.
fn gaps(case: &Case, cameras: &[(CameraId, &str)]) -> Vec<(BTreeSet<CameraId>, usize)> {
    let mut seen_by: BTreeMap<FrameId, BTreeSet<CameraId>> = BTreeMap::new();
    for used in case.used_views().filter(|used| used.fit.rms_px.is_some()) {
        seen_by.entry(used.view.frame).or_default().insert(used.view.camera);
    }
    let tree = strongest_tree(cameras, &seen_by);
    let gap = |link: usize| {
        let side = smaller_side(cameras, &tree, link);
        let is_shared = |cameras: &&BTreeSet<CameraId>| {
            cameras.iter().any(|camera| side.contains(camera))
                && !cameras.iter().all(|camera| side.contains(camera))
        };
        let n_shared = seen_by.values().filter(is_shared).count();
        (side, n_shared)
    };
    (0..tree.len()).map(gap).collect()
}

type Link = (CameraId, CameraId);

/// Returns the links between cameras that share most frames and connect all of them, without circles.
///
/// Whatever cut through the rig is weakest, one of these links crosses it alone.
fn strongest_tree(
    cameras: &[(CameraId, &str)],
    seen_by: &BTreeMap<FrameId, BTreeSet<CameraId>>,
) -> Vec<Link> {
    let n_shared = |(one, other): Link| {
        seen_by.values().filter(|cameras| cameras.contains(&one) && cameras.contains(&other)).count()
    };
    let mut links = Vec::new();
    for (i, (one, _)) in cameras.iter().enumerate() {
        links.extend(cameras[i + 1..].iter().map(|(other, _)| (n_shared((*one, *other)), (*one, *other))));
    }
    // A stable sort: of equals, the first cameras are linked first.
    links.sort_by_key(|(n, _)| std::cmp::Reverse(*n));
    let mut group: BTreeMap<CameraId, CameraId> = cameras.iter().map(|(id, _)| (*id, *id)).collect();
    let mut tree = Vec::new();
    for (_, (one, other)) in links {
        let (Some(&keep), Some(&merge)) = (group.get(&one), group.get(&other)) else { continue };
        if keep != merge {
            group.values_mut().filter(|label| **label == merge).for_each(|label| *label = keep);
            tree.push((one, other));
        }
    }
    tree
}

/// Returns the cameras on the smaller side of a link; of two equal sides, the one without the first camera.
fn smaller_side(cameras: &[(CameraId, &str)], tree: &[Link], cut: usize) -> BTreeSet<CameraId> {
    let mut side: BTreeSet<CameraId> = cameras.first().map(|(id, _)| *id).into_iter().collect();
    // As many rounds as there are links reach everything on this side.
    for _ in tree {
        for (_, (one, other)) in tree.iter().enumerate().filter(|(i, _)| *i != cut) {
            if side.contains(one) || side.contains(other) {
                side.extend([*one, *other]);
            }
        }
    }
    let other_side: BTreeSet<CameraId> =
        cameras.iter().map(|(id, _)| *id).filter(|id| !side.contains(id)).collect();
    if side.len() < other_side.len() { side } else { other_side }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(frames: &[&[u32]], expected: &[(&[u32], usize)]) {
        let cameras: Vec<(CameraId, &str)> = (0..4).map(|i| (CameraId(i), "")).collect();
        let seen_by: BTreeMap<FrameId, BTreeSet<CameraId>> = (0..)
            .zip(frames)
            .map(|(frame, seen)| (FrameId(frame), seen.iter().map(|&i| CameraId(i)).collect()))
            .collect();
        let tree = strongest_tree(&cameras, &seen_by);
        let mut sides: Vec<(Vec<u32>, usize)> = (0..tree.len())
            .map(|link| {
                let side = smaller_side(&cameras, &tree, link);
                let shared = seen_by.values().filter(|seen| {
                    seen.iter().any(|id| side.contains(id)) && seen.iter().any(|id| !side.contains(id))
                });
                (side.iter().map(|id| id.0).collect(), shared.count())
            })
            .collect();
        sides.sort();
        let expected: Vec<(Vec<u32>, usize)> = expected.iter().map(|(side, n)| (side.to_vec(), *n)).collect();
        assert_eq!(sides, expected);
    }

    #[test]
    fn groups_are_cut_where_they_are_weakest() {
        // Two pairs that share one frame.
        check(&[&[0, 1], &[0, 1], &[0, 1], &[2, 3], &[2, 3], &[1, 2]], &[(&[0], 3), (&[2, 3], 1), (&[3], 2)]);
        // A camera that shares one frame with each of the others has three.
        check(&[&[0, 1, 2], &[0, 1, 2], &[0, 3], &[1, 3], &[2, 3]], &[(&[1], 3), (&[2], 3), (&[3], 3)]);
        // One that shares none.
        check(&[&[0, 1, 2], &[3]], &[(&[1], 1), (&[2], 1), (&[3], 0)]);
    }
}
