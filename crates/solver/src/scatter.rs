//! The outer products of elimination, added where a sparse system has room for them.

use pulp::Simd;

use crate::linearization::SIDE;
use crate::step::{COLUMNS, Panel};
use crate::structure::Group;

/// Adds `Yᵀ Y` to the entries of the lower triangle by columns, at the places that the pattern tells.
///
/// Panels end right of their run; what they add there is zero.
#[inline(always)]
pub(crate) fn add_outer_sparse<S: Simd>(
    simd: S,
    group: &Group,
    places: &[u32],
    y: &[Panel],
    entries: &mut [f64],
) {
    let mut next_place = 0;
    let mut first_panel = 0;
    for (run_idx, &(_, _, length)) in group.runs.iter().enumerate() {
        let n_panels = length.div_ceil(COLUMNS);
        for row in 0..length {
            let panel = &y[first_panel + row / COLUMNS];
            let mut factors = [simd.splat_f64s(0.0); SIDE];
            for (factor, row_of_panel) in factors.iter_mut().zip(&panel.0) {
                *factor = simd.splat_f64s(row_of_panel[row % COLUMNS]);
            }
            // The column's own run, from the diagonal on: what is left of it in its panel is left out.
            let mut place = places[next_place] as usize;
            next_place += 1;
            let skipped = row % COLUMNS;
            let mut products = [0.0; COLUMNS];
            add_panel(simd, &factors, panel, &mut products);
            for (entry, product) in entries[place..].iter_mut().zip(&products[skipped..]) {
                *entry += product;
            }
            place += COLUMNS - skipped;
            for panel_idx in row / COLUMNS + 1..n_panels {
                let panel = &y[first_panel + panel_idx];
                add_panel(simd, &factors, panel, &mut entries[place..place + COLUMNS]);
                place += COLUMNS;
            }
            let mut panel_idx = first_panel + n_panels;
            for &(_, _, length) in &group.runs[run_idx + 1..] {
                let mut place = places[next_place] as usize;
                next_place += 1;
                for _ in 0..length.div_ceil(COLUMNS) {
                    let panel = &y[panel_idx];
                    add_panel(simd, &factors, panel, &mut entries[place..place + COLUMNS]);
                    panel_idx += 1;
                    place += COLUMNS;
                }
            }
        }
        first_panel += n_panels;
    }
}

/// Adds the products of one column with the columns of a panel.
#[inline(always)]
fn add_panel<S: Simd>(simd: S, factors: &[S::f64s; SIDE], panel: &Panel, entries: &mut [f64]) {
    let (vectors, _) = S::as_simd_f64s(panel.0.as_flattened());
    let (targets, _) = S::as_mut_simd_f64s(entries);
    let n_parts = vectors.len() / SIDE;
    for (part, target) in targets.iter_mut().enumerate() {
        let mut sum = *target;
        for k in 0..SIDE {
            sum = simd.mul_add_f64s(factors[k], vectors[k * n_parts + part], sum);
        }
        *target = sum;
    }
}
