//! Residuals that point the same way in parts of the image.

use std::collections::BTreeMap;

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};
use crate::statistics::median;

/// Cells of the image, across and down.
const CELLS: [usize; 2] = [8, 6];

/// Fewer views do not make a direction: what corners of one view have in common may be its pose or its blur.
const MIN_VIEWS_IN_CELL: usize = 4;

/// The common part of the residuals relative to the scatter of a coordinate.
const CAUTION_ABOVE: f64 = 0.35;
const FAIL_ABOVE: f64 = 1.0;

/// Residuals below this many pixels are rounding or interpolation, whatever their direction.
const NEGLIGIBLE_PX: f64 = 0.02;

/// The ratio of sigma to the median of absolute deviations.
const SIGMA_PER_MEDIAN: f64 = 1.4826;

/// Residuals that point the same way in parts of the image.
pub(super) struct BiasedResiduals;

/// What was seen in a part of the image.
#[derive(Clone, Default)]
struct Cell {
    /// The median residual of each view that has corners there.
    views: Vec<[f64; 2]>,
    /// All residuals, u and v.
    residuals: [Vec<f64>; 2],
}

impl Cell {
    /// Returns the mean of the views' residuals, and the mean square that chance would give it.
    fn common(&self) -> ([f64; 2], f64) {
        let n = self.views.len() as f64;
        let common = [0, 1].map(|axis| self.views.iter().map(|view| view[axis]).sum::<f64>() / n);
        let square = |view: &[f64; 2]| (view[0] - common[0]).powi(2) + (view[1] - common[1]).powi(2);
        (common, self.views.iter().map(square).sum::<f64>() / (n - 1.0) / n)
    }
}

impl Diagnostic for BiasedResiduals {
    const CODE: &'static str = "biased-residuals";

    const EXPLANATION: &'static str = "\
What it means: in parts of the image the residuals point the same way in all
views. The image is divided into cells; the number is the root mean square of
the residual that views have in common in each, less what chance would leave
(as the differences between views tell), relative to the scatter of the
residuals. Rejected corners count too, for a lens that does not fit rejects the
corners that would show it.

Why it matters: noise has no direction. What is common to all views is an error
of the lens model, or of the target's shape: the lens of the calibration is off
by about as much, and every corner adds to its apparent certainty without
making it truer. A low RMS does not exclude that, as the middle of the image
outweighs its corners.

How to fix it: take a lens model with more freedom, or one of another family:
opencv8 and not opencv5 for a wide lens, kannala-brandt4 or a splined model for
a fisheye; or let --model auto choose. If the pattern goes with the board and
not with the image, let the shape of the target be estimated. Check that the
image size is right and that images were not scaled, cropped or undistorted.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(id, name, placed)| {
            let mut cells = vec![Cell::default(); CELLS[0] * CELLS[1]];
            for used in case.used_views_of(id) {
                let mut by_cell: BTreeMap<usize, [Vec<f64>; 2]> = BTreeMap::new();
                let residuals = used.view.observations.iter().zip(&used.fit.residuals_px);
                // What the lens does not see has no direction to be biased in.
                for (seen, residual) in residuals.filter(|(_, [u, v])| u.is_finite() && v.is_finite()) {
                    let place = [0, 1].map(|axis| {
                        let across = (seen.pixel[axis] + 0.5) / f64::from(placed.camera.image_size[axis]);
                        ((across * CELLS[axis] as f64).max(0.0) as usize).min(CELLS[axis] - 1)
                    });
                    let own = by_cell.entry(place[1] * CELLS[0] + place[0]).or_default();
                    (0..2).for_each(|axis| own[axis].push(residual[axis]));
                }
                for (cell, own) in by_cell {
                    // A median, so that a gross error does not stand for its neighbours.
                    if let [Some(u), Some(v)] = [0, 1].map(|axis| median(own[axis].iter().copied())) {
                        cells[cell].views.push([u, v]);
                    }
                    (0..2).for_each(|axis| cells[cell].residuals[axis].extend(&own[axis]));
                }
            }
            cells.retain(|cell| cell.views.len() >= MIN_VIEWS_IN_CELL);
            let commons: Vec<([f64; 2], f64)> = cells.iter().map(Cell::common).collect();
            // The scatter about the common part.
            let deviations = cells.iter().zip(&commons).flat_map(|(cell, (common, _))| {
                (0..2).flat_map(move |axis| cell.residuals[axis].iter().map(move |r| (r - common[axis]).abs()))
            });
            let scatter_px = SIGMA_PER_MEDIAN * median(deviations)?;
            let (mut sum, mut n_all, mut worst) = (0.0, 0.0, 0.0f64);
            for (cell, (common, chance)) in cells.iter().zip(&commons) {
                let n = cell.residuals[0].len() as f64;
                let square = common[0] * common[0] + common[1] * common[1];
                sum += n * (square - chance);
                n_all += n;
                worst = worst.max(square);
            }
            let bias_px = (sum / n_all).max(0.0).sqrt();
            let ratio = bias_px / scatter_px.max(f64::MIN_POSITIVE);
            if bias_px <= NEGLIGIBLE_PX || ratio <= CAUTION_ABOVE {
                return None;
            }
            let is_fail = ratio > FAIL_ABOVE;
            Some(Found {
                severity: if is_fail { Severity::Fail } else { Severity::Caution },
                place: name.to_owned(),
                message: format!(
                    "in parts of the image all residuals point the same way, by {bias_px:.2} px and up to {:.2} px, against a scatter of {scatter_px:.2} px: {} does not fit the lens",
                    worst.sqrt(),
                    placed.camera.model
                ),
                measured: Some(ratio),
                limit: Some(if is_fail { FAIL_ABOVE } else { CAUTION_ABOVE }),
                fix: "Take a lens model with more freedom or of another family, or let --model auto choose."
                    .to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        // Believed residuals grow outward, as a lens that lacks a coefficient leaves them.
        let bent = |by_px: f64| {
            let mut example = Example::mono();
            for (view, fit) in example.dataset.views.iter().zip(&mut example.calibration.views) {
                for (seen, residual) in view.observations.iter().zip(&mut fit.residuals_px) {
                    let off = [(seen.pixel[0] - 800.0) / 1000.0, (seen.pixel[1] - 600.0) / 1000.0];
                    let square = off[0] * off[0] + off[1] * off[1];
                    (0..2).for_each(|axis| residual[axis] += by_px * off[axis] * (1.0 - 3.0 * square));
                }
            }
            example
        };
        vec![(bent(0.6), Severity::Caution), (bent(6.0), Severity::Fail)]
    }
}
