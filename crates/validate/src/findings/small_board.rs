//! Targets that are small in every image of a camera.

use boresight_data::{CameraId, Severity, View};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The largest board's share of the image's diagonal below which a lens is hard to learn.
const CAUTION_BELOW: f64 = 0.25;

/// Targets that are small in every image of a camera.
pub(super) struct SmallBoard;

impl Diagnostic for SmallBoard {
    const CODE: &'static str = "small-board";

    const EXPLANATION: &'static str = "\
What it means: in no image of this camera does the board span a quarter of the
image's diagonal. The span is from the first to the last corner that was seen.

Why it matters: a small board looks the same whether it is near or far, as its
perspective is weak: its far side is hardly smaller than its near side. The
focal length then hangs on little, and with it every distance. Each view also
covers a small part of the image, so that the lens is learnt in patches whose
boards may shift against each other.

How to fix it: come closer, or use a larger board. A view in which the board
fills the image is worth several in which it fills a tenth. Keep it sharp: near
a camera that is focused far away, a larger board at a distance is better than a
small one close by.";

    fn find(case: &Case) -> Vec<Found> {
        let estimated = case.cameras().filter(|(_, name, _)| !case.lens_is_held(name));
        let found = estimated.filter_map(|(id, name, _)| {
            let share = largest_board(case, id)?;
            (share < CAUTION_BELOW).then(|| Found {
                severity: Severity::Caution,
                place: name.to_owned(),
                message: format!(
                    "even where it is largest, the board spans {:.0} % of the image's diagonal",
                    100.0 * share
                ),
                measured: Some(share),
                limit: Some(CAUTION_BELOW),
                fix: "Come closer or use a larger board, so that it fills the image in some views."
                    .to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        use boresight_synthetic::{Placement, Recipe};

        let near = Recipe::mono();
        let placement = Placement { distance_m: [3.0, 4.0], ..near.placement };
        vec![(Example::of(Recipe { placement, ..near }), Severity::Caution)]
    }
}

/// Returns the share of the image's diagonal that the corners span in the view where they span most.
pub(crate) fn largest_board(case: &Case, camera: CameraId) -> Option<f64> {
    let [width, height] = case.dataset.cameras.get(camera)?.image_size.map(f64::from);
    let spans = case.used_views_of(camera).map(|used| span_px(used.view));
    spans.max_by(f64::total_cmp).map(|span| span / width.hypot(height))
}

/// Returns the diagonal of the rectangle about a view's corners.
fn span_px(view: &View) -> f64 {
    let sides = [0, 1].map(|axis| {
        let along = || view.observations.iter().map(|observation| observation.pixel[axis]);
        (along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)).max(0.0)
    });
    sides[0].hypot(sides[1])
}
