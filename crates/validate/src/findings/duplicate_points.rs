//! Two points of a target at one pixel.

use boresight_data::{Observation, Severity};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found, count};

/// Two corners that are nearer than this cannot both have been detected.
const NOTE_BELOW_PX: f64 = 0.5;

/// Two points of a target at one pixel.
pub(super) struct DuplicatePoints;

impl Diagnostic for DuplicatePoints {
    const CODE: &'static str = "duplicate-points";

    const EXPLANATION: &'static str = "\
What it means: in one view, two different points of a target are reported at the
same pixel, to half a pixel. Rejected observations count too: this is about the
input.

Why it matters: two corners of a board cannot be seen at one place. The detector
has counted a corner twice, and then one of the two labels is wrong, often with
all labels of that row or column; or the file was assembled with a mistake, such
as a column that is repeated. The rejection of outliers usually copes with
single points, and not with whole rows.

How to fix it: look at the corners drawn into the named image. Detect again with
another detector or at full resolution, or remove the view. If many views are
affected, check the program that wrote the corners: which index it writes, and
whether it writes each corner once.";

    fn find(case: &Case) -> Vec<Found> {
        let pairs = case.dataset.views.iter().map(|view| (view, close_pairs(&view.observations)));
        let affected: Vec<_> = pairs.filter(|(_, n)| *n > 0).collect();
        let Some((first, _)) = affected.first() else { return Vec::new() };
        let n_pairs: usize = affected.iter().map(|(_, n)| n).sum();
        let first = case.view_name(first);
        vec![Found {
            severity: Severity::Note,
            place: first.clone(),
            message: format!(
                "{} of different points at one pixel in {}, first here",
                count(n_pairs, "pair"),
                count(affected.len(), "view")
            ),
            measured: Some(n_pairs as f64),
            limit: Some(0.0),
            fix: format!("Look at the corners of {first}; detect again or remove the view."),
        }]
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        let observations = &mut example.dataset.views[2].observations;
        observations[5].pixel = observations[0].pixel;
        example.refit();
        vec![(example, Severity::Note)]
    }
}

/// Returns the number of pairs of points that are too close.
fn close_pairs(observations: &[Observation]) -> usize {
    let mut pixels: Vec<[f64; 2]> = observations.iter().map(|observation| observation.pixel).collect();
    pixels.sort_unstable_by(|one, other| one[0].total_cmp(&other[0]));
    let mut n_pairs = 0;
    for (i, one) in pixels.iter().enumerate() {
        let next = pixels[i + 1..].iter().take_while(|next| next[0] - one[0] < NOTE_BELOW_PX);
        n_pairs += next.filter(|next| (next[0] - one[0]).hypot(next[1] - one[1]) < NOTE_BELOW_PX).count();
    }
    n_pairs
}

#[cfg(test)]
mod tests {
    use boresight_data::PointId;

    use super::*;

    #[test]
    fn pairs_are_counted_once() {
        let at = |u: f64, v: f64| Observation { point: PointId(0), pixel: [u, v], sigma_px: 1.0 };
        assert_eq!(close_pairs(&[at(10.0, 5.0), at(3.0, 5.0), at(10.3, 5.3), at(10.1, 9.0)]), 1);
        assert_eq!(close_pairs(&[at(1.0, 1.0); 3]), 3);
        assert_eq!(close_pairs(&[]), 0);
    }
}
