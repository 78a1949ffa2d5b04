//! From the reduced columns back to the eliminated blocks, for the step and for any other right side.

use pulp::{Simd, WithSimd};

use crate::linearization::{GroupSums, Linearization, SIDE};
use crate::problem::Problem;
use crate::step::{PartialSum, StepSolver, backward, forward};
use crate::structure::{Group, Structure};
use crate::threads::Threads;

impl StepSolver {
    /// Multiplies `x`, by all tangent columns, by the inverse of the factored model; what is held becomes zero.
    pub(crate) fn apply_inverse(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        model: &Linearization,
        threads: &Threads,
        x: &mut [f64],
    ) {
        let groups: Vec<&GroupSums> = model.groups().collect();
        let right = Right::Of { x, first_column: &structure.first_column };
        let mut reduced = vec![0.0; structure.n_reduced];
        for (full, column) in structure.each_reduced() {
            reduced[column] = x[full];
        }
        let arch = self.arch;
        threads.for_each(&mut self.partial_sums, |idx, into| {
            let range = structure.schur_chunks[idx].clone();
            let (groups, sums) = (&structure.groups[range.clone()], &groups[range]);
            arch.dispatch(Condense { right, groups, sums, into });
        });
        for part in &self.partial_sums {
            reduced.iter_mut().zip(&part.gradient).for_each(|(entry, part)| *entry -= part);
        }
        self.reduced.apply_inverse(&mut reduced);
        threads.for_each(&mut self.partial_sums, |idx, into| {
            let range = structure.schur_chunks[idx].clone();
            let (groups, sums) = (&structure.groups[range.clone()], &groups[range]);
            arch.dispatch(Substitute { right, groups, sums, reduced: &reduced, into });
        });
        x.fill(0.0);
        for (full, column) in structure.each_reduced() {
            x[full] = reduced[column];
        }
        for (block, _, found) in eliminated(structure, &groups, &self.partial_sums) {
            copy_free(problem, block, found, &mut x[structure.first_column[block]..][..SIDE]);
        }
    }
}

/// Returns each eliminated block with its group's sums and what substitution found for it.
pub(crate) fn eliminated<'a>(
    structure: &'a Structure,
    sums: &'a [&'a GroupSums],
    partial_sums: &'a [PartialSum],
) -> impl Iterator<Item = (usize, &'a GroupSums, &'a [f64; SIDE])> {
    structure.schur_chunks.iter().zip(partial_sums).flat_map(|(range, part)| {
        let groups = structure.groups[range.clone()].iter().zip(&sums[range.clone()]);
        let blocks = groups.filter_map(|(group, sums)| Some((group.eliminated?, *sums)));
        blocks.zip(&part.found).map(|((block, sums), found)| (block, sums, found))
    })
}

/// Copies what was found for a block, and zeros for what is held of it.
pub(crate) fn copy_free(problem: &Problem<'_>, block: usize, found: &[f64; SIDE], into: &mut [f64]) {
    let held = &problem.parameters.blocks[block].held;
    for ((entry, found), held) in into.iter_mut().zip(found).zip(held) {
        *entry = if *held { 0.0 } else { *found };
    }
}

/// What the eliminated blocks' own matrices are to be solved for.
#[derive(Clone, Copy)]
pub(crate) enum Right<'a> {
    /// What cancels the gradient.
    LessGradient,
    /// A vector by all tangent columns, in which each block has its first.
    Of { x: &'a [f64], first_column: &'a [usize] },
}

impl Right<'_> {
    #[inline(always)]
    fn of(self, block: usize, sums: &GroupSums) -> [f64; SIDE] {
        let mut right = sums.gradient;
        match self {
            Right::LessGradient => right.iter_mut().for_each(|entry| *entry = -*entry),
            Right::Of { x, first_column } => right.copy_from_slice(&x[first_column[block]..][..SIDE]),
        }
        right
    }
}

/// Finds the eliminated blocks of some groups: `A⁻¹ (right - W reduced)`.
pub(crate) struct Substitute<'a> {
    pub right: Right<'a>,
    pub groups: &'a [Group],
    pub sums: &'a [&'a GroupSums],
    pub reduced: &'a [f64],
    pub into: &'a mut PartialSum,
}

impl WithSimd for Substitute<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { right, groups, sums, reduced, into } = self;
        into.found.clear();
        let mut triangles = into.triangles.iter();
        for (group, sums) in groups.iter().zip(sums) {
            let Some(block) = group.eliminated else { continue };
            let Some(triangle) = triangles.next() else { return };
            let n = group.columns.len();
            let mut own = right.of(block, sums);
            for &(place, column, length) in group.runs.iter() {
                let reduced = &reduced[column..column + length];
                for (k, own) in own.iter_mut().enumerate() {
                    *own -= dot(simd, &sums.coupling[k * n + place..][..length], reduced);
                }
            }
            forward(triangle, &mut own);
            backward(triangle, &mut own);
            into.found.push(own);
        }
    }
}

/// Sums what the eliminated blocks of some groups hand on to the reduced columns: `Wᵀ A⁻¹ right`.
struct Condense<'a> {
    right: Right<'a>,
    groups: &'a [Group],
    sums: &'a [&'a GroupSums],
    into: &'a mut PartialSum,
}

impl WithSimd for Condense<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { right, groups, sums, into } = self;
        into.gradient.fill(0.0);
        let mut triangles = into.triangles.iter();
        for (group, sums) in groups.iter().zip(sums) {
            let Some(block) = group.eliminated else { continue };
            let Some(triangle) = triangles.next() else { return };
            let n = group.columns.len();
            let mut own = right.of(block, sums);
            forward(triangle, &mut own);
            backward(triangle, &mut own);
            for &(place, column, length) in group.runs.iter() {
                let sum = &mut into.gradient[column..column + length];
                for (k, own) in own.iter().enumerate() {
                    add_scaled(simd, sum, &sums.coupling[k * n + place..][..length], *own);
                }
            }
        }
    }
}

/// Returns the sum of products.
#[inline(always)]
fn dot<S: Simd>(simd: S, a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_tail), (b, b_tail)) = (S::as_simd_f64s(a), S::as_simd_f64s(b));
    let mut sum = simd.splat_f64s(0.0);
    for (&a, &b) in a.iter().zip(b) {
        sum = simd.mul_add_f64s(a, b, sum);
    }
    simd.reduce_sum_f64s(sum) + a_tail.iter().zip(b_tail).map(|(a, b)| a * b).sum::<f64>()
}

/// Adds `factor` times `part` to `sum`.
#[inline(always)]
fn add_scaled<S: Simd>(simd: S, sum: &mut [f64], part: &[f64], factor: f64) {
    let factors = simd.splat_f64s(factor);
    let ((sum, sum_tail), (part, part_tail)) = (S::as_mut_simd_f64s(sum), S::as_simd_f64s(part));
    for (sum, part) in sum.iter_mut().zip(part) {
        *sum = simd.mul_add_f64s(factors, *part, *sum);
    }
    for (sum, part) in sum_tail.iter_mut().zip(part_tail) {
        *sum += factor * part;
    }
}
