//! From the quadratic model to a step: damp, eliminate, factor the reduced system, substitute back.

use pulp::{Arch, Simd, WithSimd};

use crate::aligned::Aligned;
use crate::linearization::{GroupSums, Linearization, SIDE};
use crate::problem::Problem;
use crate::reduced::Reduced;
use crate::scatter::add_outer_sparse;
use crate::structure::{Group, Structure};
use crate::substitution::{Right, Substitute, copy_free, eliminated};
use crate::threads::Threads;

/// The room in which steps are worked out, and the last one.
pub(crate) struct StepSolver {
    pub(crate) arch: Arch,
    pub(crate) partial_sums: Vec<PartialSum>,
    pub reduced: Reduced,
    /// The step by all tangent columns; zero for held ones.
    pub step: Vec<f64>,
    /// The decrease of the cost that the model predicts for it.
    pub predicted_decrease: f64,
}

/// What elimination subtracts from the reduced system, over one chunk of groups; empty until it is needed.
#[derive(Debug, Default)]
pub(crate) struct PartialSum {
    /// The upper triangle, row by row, [`row_stride`] apart.
    matrix: Aligned,
    pub(crate) gradient: Vec<f64>,
    /// The coupling after forward substitution, of the groups that wait to be multiplied.
    solved: Vec<Panel>,
    failed: bool,
    /// The factors of the eliminated blocks' own matrices.
    pub(crate) triangles: Vec<Triangle>,
    /// What substitution found for the eliminated blocks.
    pub(crate) found: Vec<[f64; SIDE]>,
}

pub(crate) type Triangle = [[f64; SIDE]; SIDE];

impl PartialSum {
    fn new(structure: &Structure) -> Self {
        let n = structure.n_reduced;
        let n_entries = structure.sparse.as_ref().map_or(n * row_stride(n), |p| p.n_entries() + COLUMNS);
        let (matrix, gradient) = (Aligned::zeros(n_entries), vec![0.0; row_stride(n)]);
        Self { matrix, gradient, ..Self::default() }
    }
}

impl StepSolver {
    pub(crate) fn new(structure: &Structure) -> Self {
        Self {
            arch: Arch::new(),
            partial_sums: structure.schur_chunks.iter().map(|_| PartialSum::default()).collect(),
            reduced: Reduced::new(structure),
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
        self.eliminate(structure, model, damping, threads) && self.reduced.factor()
    }

    /// Assembles the reduced system of the model with `damping` times its diagonal added; tells whether
    /// all that is eliminated is positive definite.
    pub(crate) fn eliminate(
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
            let places = structure.sparse.as_ref().map(|pattern| &pattern.groups[range.clone()]);
            let (groups, sums) = (&structure.groups[range.clone()], &groups[range]);
            if sum.gradient.is_empty() {
                *sum = PartialSum::new(structure);
            }
            arch.dispatch(Eliminate {
                places,
                stride: row_stride(structure.n_reduced),
                groups,
                sums,
                damping,
                into: sum,
            });
        });
        if self.partial_sums.iter().any(|sum| sum.failed) {
            return false;
        }
        let parts: Vec<(&[f64], &[f64])> =
            self.partial_sums.iter().map(|sum| (&*sum.matrix, sum.gradient.as_slice())).collect();
        self.reduced.assemble(structure, &model.reduced, damping, &parts, threads);
        true
    }

    /// Works out the step of the factored model and its predicted decrease.
    pub(crate) fn solve(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        model: &Linearization,
        damping: f64,
        threads: &Threads,
    ) {
        self.reduced.solve();
        let reduced_step = &self.reduced.step;
        // The decrease of |r|² is -2 gᵀd - dᵀHd = dᵀ(damping D d - g), since (H + damping D) d = -g.
        let mut decrease = 0.0;
        for (column, &d) in reduced_step.iter().enumerate() {
            let diagonal = model.reduced.damping[column];
            decrease += d * (damping * diagonal * d - model.reduced.gradient[column]);
        }
        let groups: Vec<&GroupSums> = model.groups().collect();
        let arch = self.arch;
        threads.for_each(&mut self.partial_sums, |idx, into| {
            let range = structure.schur_chunks[idx].clone();
            let (groups, sums) = (&structure.groups[range.clone()], &groups[range]);
            arch.dispatch(Substitute {
                right: Right::LessGradient,
                groups,
                sums,
                reduced: reduced_step,
                into,
            });
        });
        for (full, column) in structure.each_reduced() {
            self.step[full] = reduced_step[column];
        }
        for (block, sums, found) in eliminated(structure, &groups, &self.partial_sums) {
            let step = &mut self.step[structure.first_column[block]..][..SIDE];
            copy_free(problem, block, found, step);
            for (k, step) in step.iter().enumerate() {
                decrease += step * (damping * damping_diagonal(sums.own[k][k]) * step - sums.gradient[k]);
            }
        }
        self.predicted_decrease = decrease;
    }
}

/// Returns what a diagonal entry is damped by: itself, or one for a parameter that nothing moves.
pub(crate) fn damping_diagonal(diagonal: f64) -> f64 {
    if diagonal > 0.0 { diagonal } else { 1.0 }
}

pub(crate) fn damped(sums: &GroupSums, damping: f64) -> Triangle {
    let mut own = sums.own;
    for (k, row) in own.iter_mut().enumerate() {
        row[k] += damping * damping_diagonal(row[k]);
    }
    own
}

/// Returns the lower Cholesky factor with the reciprocals of its diagonal, or `None` if there is none.
#[expect(clippy::needless_range_loop, reason = "indices as in the formula, over two matrices")]
pub(crate) fn cholesky(matrix: &Triangle) -> Option<Triangle> {
    let mut lower = [[0.0; SIDE]; SIDE];
    for j in 0..SIDE {
        let mut pivot = matrix[j][j];
        for k in 0..j {
            pivot -= lower[j][k] * lower[j][k];
        }
        // A pivot lost to rounding is no pivot.
        let is_pivot = pivot > 1e-15 * matrix[j][j];
        if !is_pivot {
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
    /// For each group, where its outer product belongs in a sparse system.
    places: Option<&'a [Vec<u32>]>,
    stride: usize,
    groups: &'a [Group],
    sums: &'a [&'a GroupSums],
    damping: f64,
    into: &'a mut PartialSum,
}

impl WithSimd for Eliminate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { places, stride, groups, sums, damping, into } = self;
        into.failed = false;
        let matrix = &mut *into.matrix;
        if places.is_some() {
            matrix.fill(0.0);
        } else {
            // What is left of where the first panel may begin is never touched.
            for (row, entries) in matrix.chunks_exact_mut(stride).enumerate() {
                entries[row.saturating_sub(COLUMNS + ROWS)..].fill(0.0);
            }
        }
        into.gradient.fill(0.0);
        into.triangles.clear();
        let mut waiting: Option<&Group> = None;
        into.solved.clear();
        for (idx, (group, sums)) in groups.iter().zip(sums).enumerate() {
            if group.eliminated.is_none() {
                continue;
            }
            // Groups with the same columns are subtracted together, while the rows are in the nearest cache.
            if let Some(first) = waiting
                && (first.columns != group.columns || into.solved.len() >= TOGETHER * first.panel_count())
            {
                add_outer(simd, stride, first, &into.solved, matrix);
                into.solved.clear();
            }
            waiting = Some(group);
            let Some(lower) = cholesky(&damped(sums, damping)) else {
                into.failed = true;
                return;
            };
            into.triangles.push(lower);
            let mut gradient = sums.gradient;
            forward(&lower, &mut gradient);
            let before = into.solved.len();
            solve_coupling(simd, group, sums, &lower, &mut into.solved);
            add_gradient(simd, group, &into.solved[before..], &gradient, &mut into.gradient);
            if let Some(places) = places {
                add_outer_sparse(simd, group, &places[idx], &into.solved, matrix);
                into.solved.clear();
                waiting = None;
            }
        }
        if let Some(first) = waiting {
            add_outer(simd, stride, first, &into.solved, matrix);
        }
    }
}

/// Groups whose products are added together, at most; more would not fit into the nearest cache.
const TOGETHER: usize = 4;

impl Group {
    /// Returns the number of panels of the group's coupling.
    fn panel_count(&self) -> usize {
        self.runs.iter().map(|&(_, _, length)| length.div_ceil(COLUMNS)).sum()
    }
}

/// Columns of a coupling are taken eight at a time, whatever the machine's registers hold.
pub(crate) const COLUMNS: usize = 8;

/// Eight columns of a coupling, row by row; each row is a cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Panel(pub [[f64; COLUMNS]; SIDE]);

/// Appends `Y = L⁻¹ W` in panels: each run of columns begins a new one, and its last is filled up with zeros.
#[inline(always)]
fn solve_coupling<S: Simd>(
    simd: S,
    group: &Group,
    sums: &GroupSums,
    lower: &Triangle,
    solved: &mut Vec<Panel>,
) {
    let n_coupled = group.columns.len();
    for &(place, _, length) in group.runs.iter() {
        let mut first = 0;
        while first < length {
            let n = (length - first).min(COLUMNS);
            let mut panel = Panel::default();
            for k in 0..SIDE {
                let row = &sums.coupling[k * n_coupled + place + first..];
                let into = &mut panel.0[k];
                // Most panels are full, and a copy of known length is two instructions instead of a call.
                match row.first_chunk::<COLUMNS>() {
                    Some(full) if n == COLUMNS => into.copy_from_slice(full),
                    _ => into[..n].copy_from_slice(&row[..n]),
                }
            }
            let (vectors, _) = S::as_mut_simd_f64s(panel.0.as_flattened_mut());
            let n_parts = vectors.len() / SIDE;
            for part in 0..n_parts {
                for i in 0..SIDE {
                    let mut x = vectors[i * n_parts + part];
                    for k in 0..i {
                        x = simd.negate_mul_add_f64s(
                            simd.splat_f64s(lower[i][k]),
                            vectors[k * n_parts + part],
                            x,
                        );
                    }
                    vectors[i * n_parts + part] = simd.mul_f64s(x, simd.splat_f64s(lower[i][i]));
                }
            }
            solved.push(panel);
            first += COLUMNS;
        }
    }
}

/// Adds `Yᵀ L⁻¹ g`.
#[inline(always)]
fn add_gradient<S: Simd>(simd: S, group: &Group, y: &[Panel], gradient: &[f64; SIDE], sums: &mut [f64]) {
    let mut panels = y.iter();
    for &(_, column, length) in group.runs.iter() {
        let targets = sums[column..].chunks_mut(COLUMNS).take(length.div_ceil(COLUMNS));
        for (target, panel) in targets.zip(&mut panels) {
            let (target, _) = S::as_mut_simd_f64s(target);
            let (vectors, _) = S::as_simd_f64s(panel.0.as_flattened());
            let n_parts = vectors.len() / SIDE;
            for (part, target) in target.iter_mut().enumerate() {
                for k in 0..SIDE {
                    *target =
                        simd.mul_add_f64s(simd.splat_f64s(gradient[k]), vectors[k * n_parts + part], *target);
                }
            }
        }
    }
}

/// Rows at once: they keep their 24 factors in registers, where there are 32.
const ROWS: usize = 4;

/// Adds `Yᵀ Y` of groups with the columns of `group` to the upper triangle of a matrix with rows `stride` apart.
///
/// Panels begin left of the diagonal and end right of their run; what they add there is never read
/// or zero.
#[inline(always)]
fn add_outer<S: Simd>(simd: S, stride: usize, group: &Group, ys: &[Panel], matrix: &mut [f64]) {
    let n_panels = group.panel_count();
    if n_panels == 0 {
        return;
    }
    let mut first_panel = 0;
    for (run_idx, &(_, column, length)) in group.runs.iter().enumerate() {
        let runs = &group.runs[run_idx..];
        let mut row = 0;
        if S::REGISTER_COUNT >= 32 {
            while row + ROWS <= length {
                let rows = &mut matrix[(column + row) * stride..(column + row + ROWS) * stride];
                for y in ys.chunks_exact(n_panels) {
                    add_rows::<S, ROWS>(simd, stride, runs, y, first_panel, row, rows);
                }
                row += ROWS;
            }
        }
        while row < length {
            let rows = &mut matrix[(column + row) * stride..(column + row + 1) * stride];
            for y in ys.chunks_exact(n_panels) {
                add_rows::<S, 1>(simd, stride, runs, y, first_panel, row, rows);
            }
            row += 1;
        }
        first_panel += length.div_ceil(COLUMNS);
    }
}

/// Adds `R` rows of `Yᵀ Y`, those from `row` on of the first of `runs`.
#[inline(always)]
fn add_rows<S: Simd, const R: usize>(
    simd: S,
    stride: usize,
    runs: &[(usize, usize, usize)],
    y: &[Panel],
    first_panel: usize,
    row: usize,
    rows: &mut [f64],
) {
    let mut factors = [[simd.splat_f64s(0.0); SIDE]; R];
    for (r, factors) in factors.iter_mut().enumerate() {
        let panel = &y[first_panel + (row + r) / COLUMNS];
        for (factor, row_of_panel) in factors.iter_mut().zip(&panel.0) {
            *factor = simd.splat_f64s(row_of_panel[(row + r) % COLUMNS]);
        }
    }
    let mut panel_idx = first_panel + row / COLUMNS;
    for (run_idx, &(_, column, length)) in runs.iter().enumerate() {
        // In the run that holds the diagonal, the panels left of it are skipped.
        let skipped = if run_idx == 0 { row / COLUMNS } else { 0 };
        let mut target = column + skipped * COLUMNS;
        for _ in skipped..length.div_ceil(COLUMNS) {
            let (vectors, _) = S::as_simd_f64s(y[panel_idx].0.as_flattened());
            let n_parts = vectors.len() / SIDE;
            for part in 0..n_parts {
                let at = target + part * S::F64_LANES;
                let mut sums = [simd.splat_f64s(0.0); R];
                for (r, sum) in sums.iter_mut().enumerate() {
                    *sum = S::as_simd_f64s(&rows[r * stride + at..r * stride + at + S::F64_LANES]).0[0];
                }
                for k in 0..SIDE {
                    let vector = vectors[k * n_parts + part];
                    for r in 0..R {
                        sums[r] = simd.mul_add_f64s(factors[r][k], vector, sums[r]);
                    }
                }
                for (r, sum) in sums.iter().enumerate() {
                    S::as_mut_simd_f64s(&mut rows[r * stride + at..r * stride + at + S::F64_LANES]).0[0] =
                        *sum;
                }
            }
            panel_idx += 1;
            target += COLUMNS;
        }
    }
}

/// Returns the distance of rows in a partial sum of `n` columns: panels may end up to seven columns
/// further, and each row begins a cache line.
pub(crate) fn row_stride(n: usize) -> usize {
    (n + COLUMNS).next_multiple_of(COLUMNS)
}
