//! From the quadratic model to a step: damp, eliminate, factor the reduced system, substitute back.

use pulp::{Arch, Simd, WithSimd};

use crate::linearization::{GroupSums, Linearization, SIDE, Threads};
use crate::problem::Problem;
use crate::reduced::Reduced;
use crate::structure::{Group, HELD, Structure};

/// The room in which steps are worked out, and the last one.
pub(crate) struct StepSolver {
    arch: Arch,
    partial_sums: Vec<PartialSum>,
    pub reduced: Reduced,
    /// The step by all tangent columns; zero for held ones.
    pub step: Vec<f64>,
    /// The decrease of the cost that the model predicts for it.
    pub predicted_decrease: f64,
}

/// What elimination subtracts from the reduced system, over one chunk of groups.
#[derive(Debug, Default)]
struct PartialSum {
    /// The upper triangle, row by row.
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    /// `SIDE` rows of the group's coupling after forward substitution.
    solved: Vec<f64>,
    failed: bool,
}

type Triangle = [[f64; SIDE]; SIDE];

impl StepSolver {
    pub(crate) fn new(structure: &Structure) -> Self {
        let n = structure.n_reduced;
        let partial_sum = |_| PartialSum {
            matrix: vec![0.0; n * n],
            gradient: vec![0.0; n],
            solved: Vec::new(),
            failed: false,
        };
        Self {
            arch: Arch::new(),
            partial_sums: structure.schur_chunks.iter().map(partial_sum).collect(),
            reduced: Reduced::new(n),
            step: vec![0.0; structure.n_columns],
            predicted_decrease: 0.0,
        }
    }

    /// Factors the model with `damping` times its diagonal added; tells whether it is positive definite.
    pub(crate) fn factor(
        &mut self,
        structure: &Structure,
        model: &Linearization,
        damping: f64,
        threads: &Threads,
    ) -> bool {
        let groups: Vec<&GroupSums> = model.groups().collect();
        let arch = self.arch;
        threads.for_each(&mut self.partial_sums, |idx, sum| {
            let range = structure.schur_chunks[idx].clone();
            let (groups, sums) = (&structure.groups[range.clone()], &groups[range]);
            arch.dispatch(Eliminate { n: structure.n_reduced, groups, sums, damping, into: sum });
        });
        if self.partial_sums.iter().any(|sum| sum.failed) {
            return false;
        }
        let parts = self.partial_sums.iter().map(|sum| (sum.matrix.as_slice(), sum.gradient.as_slice()));
        self.reduced.assemble(structure, &model.reduced, damping, parts);
        self.reduced.factor()
    }

    /// Works out the step of the factored model and its predicted decrease.
    pub(crate) fn solve(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        model: &Linearization,
        damping: f64,
    ) {
        self.reduced.solve();
        let reduced_step = &self.reduced.step;
        // The decrease of |r|² is -2 gᵀd - dᵀHd = dᵀ(damping D d - g), since (H + damping D) d = -g.
        let mut decrease = 0.0;
        for (column, &d) in reduced_step.iter().enumerate() {
            let diagonal = damping_diagonal(model.reduced.diagonal[column]);
            decrease += d * (damping * diagonal * d - model.reduced.gradient[column]);
        }
        for (block, columns) in structure.reduced_columns.iter().enumerate() {
            for (k, &column) in columns.iter().enumerate().filter(|&(_, &column)| column != HELD) {
                self.step[structure.first_column[block] + k] = reduced_step[column as usize];
            }
        }
        for (group, sums) in structure.groups.iter().zip(model.groups()) {
            let Some(block) = group.eliminated else { continue };
            let n = group.columns.len();
            let mut right = sums.gradient;
            for (right, row) in right.iter_mut().zip(sums.coupling.chunks_exact(n.max(1))) {
                for (entry, &column) in row.iter().zip(&group.columns) {
                    *right += entry * reduced_step[column as usize];
                }
            }
            let Some(triangle) = cholesky(&damped(sums, damping)) else { continue };
            forward(&triangle, &mut right);
            backward(&triangle, &mut right);
            let first = structure.first_column[block];
            for (k, right) in right.iter().enumerate() {
                let held = problem.parameters.blocks[block].held[k];
                let d = if held { 0.0 } else { -right };
                self.step[first + k] = d;
                decrease += d * (damping * damping_diagonal(sums.own[k][k]) * d - sums.gradient[k]);
            }
        }
        self.predicted_decrease = decrease;
    }
}

/// Returns what a diagonal entry is damped by: itself, or one for a parameter that nothing moves.
pub(crate) fn damping_diagonal(diagonal: f64) -> f64 {
    if diagonal > 0.0 { diagonal } else { 1.0 }
}

fn damped(sums: &GroupSums, damping: f64) -> Triangle {
    let mut own = sums.own;
    for (k, row) in own.iter_mut().enumerate() {
        row[k] += damping * damping_diagonal(row[k]);
    }
    own
}

/// Returns the lower Cholesky factor with the reciprocals of its diagonal, or `None` if there is none.
pub(crate) fn cholesky(matrix: &Triangle) -> Option<Triangle> {
    let mut lower = [[0.0; SIDE]; SIDE];
    for j in 0..SIDE {
        let mut pivot = matrix[j][j];
        for k in 0..j {
            pivot -= lower[j][k] * lower[j][k];
        }
        // A pivot lost to rounding is no pivot.
        if !(pivot > 1e-15 * matrix[j][j]) {
            return None;
        }
        let reciprocal = 1.0 / pivot.sqrt();
        lower[j][j] = reciprocal;
        for i in j + 1..SIDE {
            let mut entry = matrix[i][j];
            for k in 0..j {
                entry -= lower[i][k] * lower[j][k];
            }
            lower[i][j] = entry * reciprocal;
        }
    }
    Some(lower)
}

pub(crate) fn forward(lower: &Triangle, x: &mut [f64; SIDE]) {
    for i in 0..SIDE {
        for k in 0..i {
            x[i] -= lower[i][k] * x[k];
        }
        x[i] *= lower[i][i];
    }
}

pub(crate) fn backward(lower: &Triangle, x: &mut [f64; SIDE]) {
    for i in (0..SIDE).rev() {
        for k in i + 1..SIDE {
            x[i] -= lower[k][i] * x[k];
        }
        x[i] *= lower[i][i];
    }
}

/// Eliminates the blocks of some groups: adds `Yᵀ Y` with `Y = L⁻¹ W`, and `Yᵀ L⁻¹ g`.
struct Eliminate<'a> {
    n: usize,
    groups: &'a [Group],
    sums: &'a [&'a GroupSums],
    damping: f64,
    into: &'a mut PartialSum,
}

impl WithSimd for Eliminate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { n, groups, sums, damping, into } = self;
        into.failed = false;
        into.matrix.fill(0.0);
        into.gradient.fill(0.0);
        for (group, sums) in groups.iter().zip(sums) {
            if group.eliminated.is_none() {
                continue;
            }
            let Some(lower) = cholesky(&damped(sums, damping)) else {
                into.failed = true;
                return;
            };
            if group.columns.is_empty() {
                continue;
            }
            let mut gradient = sums.gradient;
            forward(&lower, &mut gradient);
            let n_coupled = group.columns.len();
            into.solved.clear();
            into.solved.extend_from_slice(&sums.coupling);
            forward_rows(simd, &lower, &mut into.solved, n_coupled);
            for (place, &column) in group.columns.iter().enumerate() {
                for (k, gradient) in gradient.iter().enumerate() {
                    into.gradient[column as usize] += into.solved[k * n_coupled + place] * gradient;
                }
            }
            add_outer(simd, n, group, &into.solved, &mut into.matrix);
        }
    }
}

/// Applies the inverse of `lower` to `SIDE` rows of `n` numbers.
#[inline(always)]
fn forward_rows<S: Simd>(simd: S, lower: &Triangle, rows: &mut [f64], n: usize) {
    for i in 0..SIDE {
        let (above, from_here) = rows.split_at_mut(i * n);
        let row = &mut from_here[..n];
        for (k, above) in above.chunks_exact(n).enumerate() {
            let factor = simd.splat_f64s(-lower[i][k]);
            let (head, tail) = S::as_mut_simd_f64s(row);
            let (above_head, above_tail) = S::as_simd_f64s(above);
            for (x, &a) in head.iter_mut().zip(above_head) {
                *x = simd.mul_add_f64s(factor, a, *x);
            }
            for (x, a) in tail.iter_mut().zip(above_tail) {
                *x -= lower[i][k] * a;
            }
        }
        let reciprocal = simd.splat_f64s(lower[i][i]);
        let (head, tail) = S::as_mut_simd_f64s(row);
        head.iter_mut().for_each(|x| *x = simd.mul_f64s(*x, reciprocal));
        tail.iter_mut().for_each(|x| *x *= lower[i][i]);
    }
}

/// Adds `Yᵀ Y` to the upper triangle of the `n` by `n` matrix, where `Y` is `SIDE` rows over the group's columns.
///
/// Two rows of the result at a time keep twelve factors in registers.
#[inline(always)]
fn add_outer<S: Simd>(simd: S, n: usize, group: &Group, y: &[f64], matrix: &mut [f64]) {
    let n_coupled = group.columns.len();
    // Plain loops: closures would be functions without the caller's SIMD instructions.
    let mut y_rows: [&[f64]; SIDE] = [&[]; SIDE];
    for (k, row) in y_rows.iter_mut().enumerate() {
        *row = &y[k * n_coupled..(k + 1) * n_coupled];
    }
    let mut place = 0;
    while place < n_coupled {
        let column = group.columns[place] as usize;
        let pair = place + 1 < n_coupled && group.columns[place + 1] as usize == column + 1;
        let mut factors = [[0.0; SIDE]; 2];
        for k in 0..SIDE {
            factors[0][k] = y_rows[k][place];
            factors[1][k] = if pair { y_rows[k][place + 1] } else { 0.0 };
        }
        let (first, second) = matrix[column * n..].split_at_mut(n);
        for &(run_place, run_column, run_length) in &group.runs {
            if run_place + run_length <= place {
                continue;
            }
            // Within the run that holds the diagonal, what is left of it is skipped.
            let skip = place.saturating_sub(run_place);
            let (from, to) = (run_column + skip, run_column + run_length);
            let mut segments = y_rows;
            for segment in &mut segments {
                *segment = &segment[run_place + skip..run_place + run_length];
            }
            let target = &mut first[from..to];
            if pair {
                add_two_rows(simd, [target, &mut second[from..to]], &segments, &factors);
            } else {
                add_row(simd, target, &segments, &factors[0]);
            }
        }
        place += if pair { 2 } else { 1 };
    }
}

#[inline(always)]
fn add_two_rows<S: Simd>(
    simd: S,
    targets: [&mut [f64]; 2],
    segments: &[&[f64]; SIDE],
    factors: &[[f64; SIDE]; 2],
) {
    let [first, second] = targets;
    let mut splat = [[simd.splat_f64s(0.0); SIDE]; 2];
    for r in 0..2 {
        for k in 0..SIDE {
            splat[r][k] = simd.splat_f64s(factors[r][k]);
        }
    }
    let (first_head, first_tail) = S::as_mut_simd_f64s(first);
    let (second_head, second_tail) = S::as_mut_simd_f64s(second);
    let n_head = first_head.len();
    let mut heads: [&[S::f64s]; SIDE] = [&[]; SIDE];
    for k in 0..SIDE {
        heads[k] = &S::as_simd_f64s(segments[k]).0[..n_head];
    }
    let second_head = &mut second_head[..n_head];
    for i in 0..n_head {
        let (mut a, mut b) = (first_head[i], second_head[i]);
        for k in 0..SIDE {
            let y = heads[k][i];
            a = simd.mul_add_f64s(splat[0][k], y, a);
            b = simd.mul_add_f64s(splat[1][k], y, b);
        }
        (first_head[i], second_head[i]) = (a, b);
    }
    if !first_tail.is_empty() {
        let (mut a, mut b) = (simd.partial_load_f64s(first_tail), simd.partial_load_f64s(second_tail));
        for k in 0..SIDE {
            let y = simd.partial_load_f64s(S::as_simd_f64s(segments[k]).1);
            a = simd.mul_add_f64s(splat[0][k], y, a);
            b = simd.mul_add_f64s(splat[1][k], y, b);
        }
        simd.partial_store_f64s(first_tail, a);
        simd.partial_store_f64s(second_tail, b);
    }
}

#[inline(always)]
fn add_row<S: Simd>(simd: S, target: &mut [f64], segments: &[&[f64]; SIDE], factors: &[f64; SIDE]) {
    let (head, tail) = S::as_mut_simd_f64s(target);
    for (k, segment) in segments.iter().enumerate() {
        let factor = simd.splat_f64s(factors[k]);
        let (segment_head, segment_tail) = S::as_simd_f64s(segment);
        for (x, &y) in head.iter_mut().zip(segment_head) {
            *x = simd.mul_add_f64s(factor, y, *x);
        }
        for (x, y) in tail.iter_mut().zip(segment_tail) {
            *x += factors[k] * y;
        }
    }
}
