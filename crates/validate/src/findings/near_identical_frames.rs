//! Frames that repeat each other.

use std::collections::BTreeMap;

use boresight_data::{CameraId, FrameId, Severity, TargetId, View};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The mean motion of corners, relative to the image's diagonal, below which two frames are one:
/// 5 px at 1600x1200.
const NOTE_BELOW: f64 = 0.0025;

/// Frames that repeat each other.
pub(super) struct NearIdenticalFrames;

impl Diagnostic for NearIdenticalFrames {
    const CODE: &'static str = "near-identical-frames";

    const EXPLANATION: &'static str = "\
What it means: in some frames the corners are where they were in another frame,
in every camera, to a quarter of a percent of the image's diagonal on average.
The board did not move between them.

Why it matters: such a frame adds nothing but a repetition of the same noise,
the same blur and the same error of the lens model. The uncertainties count it
as new evidence and become too small, by up to the root of the number of
repetitions; a place that is repeated often also weighs more than the rest of
the image. And where repetitions are on both sides of a split, held-out errors
look better than they are.

How to fix it: keep one frame of each group, the sharpest. When recording a
film, take every tenth frame, or let the board move between the frames that are
kept.";

    fn find(case: &Case) -> Vec<Found> {
        let repeated = repeated_frames(case);
        let Some((frame, original)) = repeated.first() else { return Vec::new() };
        let name = |id: &FrameId| case.dataset.frames.get(*id).map_or("?", |frame| frame.name.as_str());
        vec![Found {
            severity: Severity::Note,
            place: name(frame).to_owned(),
            message: format!(
                "{} of {} frames nearly repeat an earlier one, first frame {} that of {}",
                repeated.len(),
                case.dataset.frames.len(),
                name(frame),
                name(original)
            ),
            measured: Some(repeated.len() as f64),
            limit: Some(0.0),
            fix: "Keep one frame of each group, and move the board between frames.".to_owned(),
        }]
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::stereo();
        let first = example.dataset.views[0].frame;
        let repeated = FrameId(first.0 + 5);
        let mut views: Vec<View> =
            example.dataset.views.iter().filter(|view| view.frame == first).cloned().collect();
        for view in &mut views {
            view.frame = repeated;
            view.observations.iter_mut().for_each(|observation| observation.pixel[0] += 1.0);
        }
        example.dataset.views.retain(|view| view.frame != repeated);
        let at = example.dataset.views.partition_point(|view| view.frame < repeated);
        example.dataset.views.splice(at..at, views);
        example.calibration.scene.rig_from_target[repeated] =
            example.calibration.scene.rig_from_target[first];
        example.refit();
        vec![(example, Severity::Note)]
    }
}

type Key = (CameraId, TargetId);

/// Returns each frame that repeats an earlier one, with the earliest such.
fn repeated_frames(case: &Case) -> Vec<(FrameId, FrameId)> {
    let mut frames: BTreeMap<FrameId, BTreeMap<Key, &View>> = BTreeMap::new();
    for used in case.used_views() {
        let key = (used.view.camera, used.view.target);
        frames.entry(used.view.frame).or_default().insert(key, used.view);
    }
    let limit_px = |camera: CameraId| {
        let image_size = case.dataset.cameras.get(camera).map_or([0, 0], |info| info.image_size);
        let [width, height] = image_size.map(f64::from);
        NOTE_BELOW * width.hypot(height)
    };
    let mut originals: Vec<(FrameId, &BTreeMap<Key, &View>)> = Vec::new();
    let mut repeated = Vec::new();
    for (frame, views) in &frames {
        let is_same = |original: &BTreeMap<Key, &View>| {
            // What only one of them saw makes them different.
            original.len() == views.len()
                && original.iter().zip(views).all(|((key, one), (other_key, other))| {
                    key == other_key && is_same_view(one, other, limit_px(key.0))
                })
        };
        match originals.iter().find(|(_, original)| is_same(original)) {
            Some((original, _)) => repeated.push((*frame, *original)),
            None => originals.push((*frame, views)),
        }
    }
    repeated
}

/// Tells whether the points that two views share, at least half of either's, moved less than the limit on average.
fn is_same_view(one: &View, other: &View, limit_px: f64) -> bool {
    let mut others = other.observations.iter().peekable();
    let (mut n, mut sum) = (0, 0.0);
    for observation in &one.observations {
        while others.next_if(|other| other.point < observation.point).is_some() {}
        let Some(twin) = others.next_if(|other| other.point == observation.point) else { continue };
        let moved = (0..2).map(|axis| twin.pixel[axis] - observation.pixel[axis]);
        let moved = moved.fold(0.0, f64::hypot);
        // Most pairs of frames part at their first point.
        if moved > 10.0 * limit_px {
            return false;
        }
        sum += moved;
        n += 1;
    }
    2 * n >= one.observations.len().max(other.observations.len()) && sum < limit_px * n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_original_is_named() {
        let (example, _) = NearIdenticalFrames::examples().remove(0);
        let case = Case::new(&example.dataset, &example.calibration);
        assert_eq!(repeated_frames(&case), [(FrameId(5), FrameId(0))]);
        let found = NearIdenticalFrames::find(&case);
        assert_eq!(
            found[0].message,
            "1 of 40 frames nearly repeat an earlier one, first frame frame005 that of frame000"
        );
    }

    #[test]
    fn a_moved_board_is_no_repetition() {
        let (mut example, _) = NearIdenticalFrames::examples().remove(0);
        for view in example.dataset.views.iter_mut().filter(|view| view.frame == FrameId(5)) {
            view.observations.iter_mut().for_each(|observation| observation.pixel[1] += 6.0);
        }
        assert!(repeated_frames(&Case::new(&example.dataset, &example.calibration)).is_empty());
    }
}
