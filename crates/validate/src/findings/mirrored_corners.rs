//! Corners that run the other way round than on the target.

use boresight_data::{Geometry, Severity, Target, View};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};

/// Corners that run the other way round than on the target.
pub(super) struct MirroredCorners;

impl Diagnostic for MirroredCorners {
    const CODE: &'static str = "mirrored-corners";

    const EXPLANATION: &'static str = "\
What it means: from the target's x axis to its y axis it is clockwise in an
image, as x runs to the right and y down on a board that is seen from its front;
on an AprilGrid, whose y runs up, it is the other way round. In the views named
the corners run against that. Either the image is mirrored, as by a mirror or a
webcam that shows people to themselves, or whoever labelled the corners counted
rows from the other end.

Why it matters: a target that is labelled so in all views is taken for one that
is seen from behind; the lens comes out right, but the target's z axis and its
bend have the wrong sign, and a robot or a map would be mirrored with it. Where
some cameras or views are mirrored and others are not, they contradict each
other: no rig and no pose of the target can satisfy both.

How to fix it: switch the mirroring off in the camera, or turn the images back,
and calibrate what the camera truly sees. For corners from elsewhere, count rows
from the top of the board's front, so that the first row is above the second.";

    fn find(case: &Case) -> Vec<Found> {
        let mut found = Vec::new();
        for (id, info) in case.dataset.cameras.enumerate() {
            let views = case.dataset.views.iter().filter(|view| view.camera == id);
            let told = views.filter_map(|view| Some((view, is_mirrored(view, case.target(view)?)?)));
            let told: Vec<(&View, bool)> = told.collect();
            let mirrored: Vec<&View> =
                told.iter().filter(|(_, is_mirrored)| *is_mirrored).map(|(view, _)| *view).collect();
            let Some(first) = mirrored.first() else { continue };
            let others_are_not =
                case.dataset.views.iter().any(|view| {
                    case.target(view).and_then(|target| is_mirrored(view, target)) == Some(false)
                });
            found.push(Found {
                severity: if others_are_not { Severity::Fail } else { Severity::Note },
                place: info.name.clone(),
                message: format!(
                    "in {} of {} the corners run the other way round than on the target, such as {}; {}",
                    mirrored.len(),
                    count(told.len(), "view"),
                    case.view_name(first),
                    if others_are_not { "in others they do not" } else { "so they do in all" }
                ),
                measured: Some(mirrored.len() as f64),
                limit: Some(0.0),
                fix: "Switch mirroring off in the camera, or count the rows of corners from the top."
                    .to_owned(),
            });
        }
        found
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mirrored = |camera: Option<u32>| {
            let mut example = Example::stereo();
            for view in &mut example.dataset.views {
                if camera.is_none_or(|camera| view.camera.0 == camera) {
                    let width = f64::from(example.dataset.cameras[view.camera].image_size[0]);
                    view.observations.iter_mut().for_each(|o| o.pixel[0] = width - 1.0 - o.pixel[0]);
                }
            }
            example
        };
        vec![(mirrored(Some(1)), Severity::Fail), (mirrored(None), Severity::Note)]
    }
}

/// Tells whether the corners of a view run the other way round than on its target; `None` where that cannot be told, as
/// the target has no front or the corners lie on a line.
fn is_mirrored(view: &View, target: &Target) -> Option<bool> {
    let clockwise = match target.geometry {
        Geometry::Chessboard { .. } | Geometry::Charuco { .. } | Geometry::Circles { .. } => 1.0,
        Geometry::AprilGrid { .. } => -1.0,
        Geometry::Points { .. } => return None,
    };
    let n = view.observations.len() as f64;
    let pairs = || {
        view.observations.iter().map(|observation| {
            let at = target.drawn_point(observation.point);
            ([at.x, at.y], observation.pixel)
        })
    };
    let mean = |value: &dyn Fn(([f64; 2], [f64; 2])) -> f64| pairs().map(value).sum::<f64>() / n;
    let of_board = [0, 1].map(|axis| mean(&|(at, _)| at[axis]));
    let of_image = [0, 1].map(|axis| mean(&|(_, pixel)| pixel[axis]));
    // The best linear map from the board to the image is C B^-1 with these covariances, and det B is positive.
    let across = |i: usize, j: usize| mean(&|(at, pixel)| (pixel[i] - of_image[i]) * (at[j] - of_board[j]));
    let on_board = |i: usize, j: usize| mean(&|(at, _)| (at[i] - of_board[i]) * (at[j] - of_board[j]));
    let spread = on_board(0, 0) * on_board(1, 1) - on_board(0, 1).powi(2);
    let determinant = across(0, 0) * across(1, 1) - across(0, 1) * across(1, 0);
    // Of no corners at all both are no numbers, and tell nothing.
    let is_spread = spread > 1e-6 * (on_board(0, 0) + on_board(1, 1)).powi(2);
    (is_spread && determinant != 0.0).then_some(determinant * clockwise < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_without_corners_or_with_a_line_of_them_tell_nothing() {
        let example = Example::mono();
        let target = example.dataset.targets.iter().next().unwrap();
        let view = &example.dataset.views[0];
        assert_eq!(is_mirrored(view, target), Some(false));
        for n in [0, 1, 2] {
            let observations = view.observations[..n].to_vec();
            assert_eq!(is_mirrored(&View { observations, ..view.clone() }, target), None, "{n}");
        }
    }
}
