//! A board that is not flat.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The deflection in millimetres from which on a board is worth replacing.
const NOTE_ABOVE_MM: f64 = 0.5;

/// A board that is not flat.
pub(super) struct Bow;

impl Diagnostic for Bow {
    const CODE: &'static str = "bow";

    const EXPLANATION: &'static str = "\
What it means: the solved shape of the target departs from its drawing by more
than half a millimetre. The first two numbers are the deflections of the middle
along x and along y, with the four edges at zero; a positive one points along
the target's +z axis, away from a camera that sees the board's first corner at
the top left. Of a shape with six coefficients, the third is how far a twist
lifts two corners and lowers the others, and the rest is what changes along the
bends.

Why it matters: the shape was part of the solution, so that the lens is not bent
to match; a bow of half a millimetre that is not solved for costs about as much
as the noise of the corners. The shape is a smooth one, though, and the same in
all frames. A real board that is bent this far rarely is either, and what is
left over goes into the lens.

How to fix it: nothing must be done if the residuals are small and show no
pattern across the board. Otherwise take a stiffer board: glass, aluminium
composite or a thick sandwich plate and not paper on cardboard, mounted without
strain. Do not hold it by its edges. If the deflections are larger than the
board could have, the lens model may be too simple, and the shape is bent to
match it.";

    fn find(case: &Case) -> Vec<Found> {
        let targets = case.calibration.scene.targets.enumerate();
        let found = targets.filter_map(|(id, belief)| {
            let shape_mm: Vec<f64> = belief.shape_m.iter().map(|m| 1e3 * m).collect();
            let largest = shape_mm.iter().fold(0.0, |largest: f64, mm| largest.max(mm.abs()));
            if largest <= NOTE_ABOVE_MM {
                return None;
            }
            let deflections = match shape_mm.as_slice() {
                [along_x, along_y] => format!("{along_x:.2} mm along x and {along_y:.2} mm along y"),
                [along_x, along_y, twist, rest @ ..] => {
                    let most = rest.iter().fold(0.0, |most: f64, mm| most.max(mm.abs()));
                    format!(
                        "{along_x:.2} mm along x, {along_y:.2} mm along y, {twist:.2} mm by a twist and up to {most:.2} mm beyond"
                    )
                }
                _ => format!("up to {largest:.2} mm"),
            };
            Some(Found {
                severity: Severity::Note,
                place: case
                    .dataset
                    .targets
                    .get(id)
                    .map_or_else(|| format!("target {id}"), |t| t.name.clone()),
                message: format!("the target is bowed by {deflections}; the solution takes it into account"),
                measured: Some(largest),
                limit: Some(NOTE_ABOVE_MM),
                fix:
                    "Use a stiffer board, mounted without strain, if the residuals show a pattern across it."
                        .to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        example
            .calibration
            .scene
            .targets
            .iter_mut()
            .for_each(|target| target.shape_m = vec![0.0001, -0.0012]);
        vec![(example, Severity::Note)]
    }
}
