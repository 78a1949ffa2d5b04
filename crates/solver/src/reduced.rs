//! The reduced system: what is left when the poses of frames are eliminated. It is dense or sparse.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, Par};

use crate::linearization::ReducedSums;
use crate::pattern::NOWHERE;
use crate::sparse::{SparseInverse, SparseSystem};
use crate::step::row_stride;
use crate::structure::{HELD, Structure};
use crate::threads::Threads;

/// Columns, or entries of a sparse system, that a thread subtracts from at a time: what it reads of each part stays in
/// the nearest cache.
const COLUMNS_AT_ONCE: usize = 16;
const ENTRIES_AT_ONCE: usize = 2048;

/// A symmetric system, scaled to a unit diagonal and factored.
pub(crate) struct Reduced {
    n: usize,
    system: System,
    gradient: Vec<f64>,
    /// The diagonal of the system, which factoring overwrites.
    pub(crate) diagonal: Vec<f64>,
    /// The inverse root of the diagonal.
    scale: Vec<f64>,
    /// The step by reduced column.
    pub step: Vec<f64>,
}

/// How the system is kept.
enum System {
    /// The matrix, then its Cholesky factor: lower triangle.
    Dense(Mat<f64>, MemBuffer),
    Sparse(Box<SparseSystem>),
}

/// The inverse of a reduced system.
#[derive(Debug)]
pub(crate) enum Inverse {
    Dense(Mat<f64>),
    Sparse(Box<SparseInverse>),
}

impl Inverse {
    /// Returns the entry at a row and a column.
    pub(crate) fn entry(&self, row: usize, column: usize) -> f64 {
        match self {
            Inverse::Dense(matrix) => matrix[(row, column)],
            Inverse::Sparse(inverse) => inverse.entry(row, column),
        }
    }

    /// Writes the product of the inverse with a vector.
    pub(crate) fn multiply(&self, x: &[f64], product: &mut [f64]) {
        match self {
            Inverse::Dense(matrix) => {
                for (column, entry) in product.iter_mut().enumerate() {
                    *entry = matrix.col_as_slice(column).iter().zip(x).map(|(entry, x)| entry * x).sum();
                }
            }
            Inverse::Sparse(inverse) => inverse.multiply(x, product),
        }
    }
}

impl Reduced {
    pub(crate) fn new(structure: &Structure) -> Self {
        let n = structure.n_reduced;
        let dense = || {
            let scratch = MemBuffer::new(cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default()));
            System::Dense(Mat::zeros(n, n), scratch)
        };
        let sparse = |pattern| System::Sparse(Box::new(SparseSystem::new(pattern)));
        Self {
            n,
            system: structure.sparse.as_ref().map_or_else(dense, sparse),
            gradient: vec![0.0; n],
            diagonal: vec![0.0; n],
            scale: vec![1.0; n],
            step: vec![0.0; n],
        }
    }

    /// Adds up the system: the sums over terms, the damping, and less what elimination subtracts.
    pub(crate) fn assemble(
        &mut self,
        structure: &Structure,
        sums: &ReducedSums,
        damping: f64,
        eliminated: &[(&[f64], &[f64])],
        threads: &Threads,
    ) {
        self.gradient.copy_from_slice(&sums.gradient);
        match &mut self.system {
            System::Dense(matrix, _) => {
                matrix.as_mut().fill(0.0);
                add_dense(structure, sums, matrix);
                for (column, &diagonal) in sums.damping.iter().enumerate() {
                    matrix[(column, column)] += damping * diagonal;
                }
            }
            System::Sparse(system) => {
                system.values.fill(0.0);
                add_sparse(structure, sums, &mut system.values);
                for (column, &diagonal) in sums.damping.iter().enumerate() {
                    let place = system.diagonal(column);
                    system.values[place] += damping * diagonal;
                }
            }
        }
        let (n, stride) = (self.n, row_stride(self.n));
        match &mut self.system {
            // The upper triangle by rows is the lower triangle by columns, which is faer's order.
            System::Dense(matrix, _) => {
                let columns =
                    matrix.as_mut().col_iter_mut().filter_map(|column| column.try_as_col_major_mut());
                let mut columns: Vec<&mut [f64]> = columns.map(|column| column.as_slice_mut()).collect();
                assert_eq!(columns.len(), n, "the matrix lies column by column");
                let mut bands: Vec<&mut [&mut [f64]]> = columns.chunks_mut(COLUMNS_AT_ONCE).collect();
                threads.for_each(&mut bands, |band, columns| {
                    for (parts, _) in eliminated {
                        for (k, column) in columns.iter_mut().enumerate() {
                            let row = band * COLUMNS_AT_ONCE + k;
                            subtract(&mut column[row..], &parts[row * stride + row..row * stride + n]);
                        }
                    }
                });
            }
            System::Sparse(system) => {
                let mut bands: Vec<&mut [f64]> = system.values.chunks_mut(ENTRIES_AT_ONCE).collect();
                threads.for_each(&mut bands, |band, entries| {
                    let first = band * ENTRIES_AT_ONCE;
                    eliminated.iter().for_each(|(parts, _)| subtract(entries, &parts[first..]));
                });
            }
        }
        eliminated.iter().for_each(|(_, gradient)| subtract(&mut self.gradient, gradient));
        for (column, diagonal) in self.diagonal.iter_mut().enumerate() {
            *diagonal = match &self.system {
                System::Dense(matrix, _) => matrix[(column, column)],
                System::Sparse(system) => system.values[system.diagonal(column)],
            };
        }
    }

    /// Returns the columns of which elimination left no more than `share` of their diagonal in `sums`.
    ///
    /// The data do not constrain these. Their diagonal is rounding, and scaling would make it a one.
    pub(crate) fn lost_columns(&self, sums: &ReducedSums, share: f64) -> Vec<usize> {
        let kept = |column: usize| self.diagonal[column] > share * sums.diagonal[column];
        (0..self.n).filter(|&column| !kept(column)).collect()
    }

    /// Returns how many times what elimination left of a column's diagonal it was in `sums`, at most: rounding is that of
    /// what was there.
    pub(crate) fn cancellation(&self, sums: &ReducedSums) -> f64 {
        sums.diagonal.iter().zip(&self.diagonal).map(|(before, after)| before / after).fold(1.0, f64::max)
    }

    /// Factors the assembled system; tells whether it is positive definite.
    pub(crate) fn factor(&mut self) -> bool {
        let n = self.n;
        for (column, &diagonal) in self.diagonal.iter().enumerate() {
            if diagonal <= 0.0 || !diagonal.is_finite() {
                return false;
            }
            self.scale[column] = 1.0 / diagonal.sqrt();
        }
        let scale = &self.scale;
        match &mut self.system {
            System::Dense(matrix, scratch) => {
                for column in 0..n {
                    let by_column = scale[column];
                    let entries = &mut matrix.col_as_slice_mut(column)[column..];
                    for (entry, by_row) in entries.iter_mut().zip(&scale[column..]) {
                        *entry *= by_column * by_row;
                    }
                }
                let stack = MemStack::new(scratch);
                cholesky_in_place(matrix.as_mut(), Default::default(), Par::Seq, stack, Default::default())
                    .is_ok()
            }
            System::Sparse(system) => {
                system.scale(scale);
                system.factor()
            }
        }
    }

    /// Solves the factored system for the step that cancels the gradient.
    pub(crate) fn solve(&mut self) {
        for (step, (gradient, scale)) in self.step.iter_mut().zip(self.gradient.iter().zip(&self.scale)) {
            *step = -gradient * scale;
        }
        self.system.solve(&mut self.step);
        for (step, scale) in self.step.iter_mut().zip(&self.scale) {
            *step *= scale;
        }
    }

    /// Multiplies a vector by the inverse of the factored system.
    pub(crate) fn apply_inverse(&mut self, x: &mut [f64]) {
        x.iter_mut().zip(&self.scale).for_each(|(x, scale)| *x *= scale);
        self.system.solve(x);
        x.iter_mut().zip(&self.scale).for_each(|(x, scale)| *x *= scale);
    }

    /// Returns the inverse of the factored system.
    pub(crate) fn into_inverse(self) -> Inverse {
        let Self { n, system, scale, .. } = self;
        match system {
            System::Dense(matrix, _) => {
                let mut inverse = Mat::<f64>::identity(n, n);
                solve_lower_triangular_in_place(matrix.as_ref(), inverse.as_mut(), Par::Seq);
                solve_upper_triangular_in_place(matrix.as_ref().transpose(), inverse.as_mut(), Par::Seq);
                for column in 0..n {
                    for row in 0..n {
                        inverse[(row, column)] *= scale[row] * scale[column];
                    }
                }
                Inverse::Dense(inverse)
            }
            System::Sparse(system) => Inverse::Sparse(Box::new(system.into_inverse(scale))),
        }
    }

    /// Returns a bound on the largest eigenvalue of the assembled system scaled to a unit diagonal: the
    /// largest sum of a row's absolute entries.
    pub(crate) fn eigenvalue_bound(&self) -> f64 {
        let scale: Vec<f64> = self.diagonal.iter().map(|diagonal| 1.0 / diagonal.sqrt()).collect();
        let mut sums = vec![1.0; self.n];
        let mut add = |row: usize, column: usize, entry: f64| {
            if row != column {
                let entry = (entry * scale[row] * scale[column]).abs();
                sums[row] += entry;
                sums[column] += entry;
            }
        };
        match &self.system {
            System::Dense(matrix, _) => {
                for column in 0..self.n {
                    let entries = matrix.col_as_slice(column).iter().enumerate().skip(column);
                    entries.for_each(|(row, &entry)| add(row, column, entry));
                }
            }
            System::Sparse(system) => system.each_entry(add),
        }
        sums.into_iter().fold(1.0, f64::max)
    }

    /// Returns an estimate of the least eigenvalue of the factored system, which has a unit diagonal, and
    /// its loosest direction, by inverse iteration on the factor.
    pub(crate) fn loosest_direction(&mut self) -> (f64, Vec<f64>) {
        let n = self.n;
        let mut direction: Vec<f64> = (0..n).map(|i| 1.0 + (i as f64 * 0.618_034).fract()).collect();
        let mut smallest = 1.0;
        for _ in 0..8 {
            let norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
            direction.iter_mut().for_each(|x| *x /= norm);
            self.system.solve(&mut direction);
            smallest = 1.0 / direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        }
        (smallest, direction)
    }
}

impl System {
    /// Multiplies a vector by the inverse of the factored system.
    fn solve(&mut self, x: &mut [f64]) {
        match self {
            System::Dense(matrix, _) => {
                let mut right = faer::MatMut::from_column_major_slice_mut(x, matrix.nrows(), 1);
                solve_lower_triangular_in_place(matrix.as_ref(), right.as_mut(), Par::Seq);
                solve_upper_triangular_in_place(matrix.as_ref().transpose(), right.as_mut(), Par::Seq);
            }
            System::Sparse(system) => system.solve(x),
        }
    }
}

/// Subtracts `parts` from as many entries as there are.
fn subtract(entries: &mut [f64], parts: &[f64]) {
    for (entry, part) in entries.iter_mut().zip(parts) {
        *entry -= part;
    }
}

/// Adds the sums over terms to the lower triangle of a matrix.
fn add_dense(structure: &Structure, sums: &ReducedSums, matrix: &mut Mat<f64>) {
    let mut add = |a: u32, b: u32, part: f64| {
        if a != HELD && b != HELD {
            matrix[(a.max(b) as usize, a.min(b) as usize)] += part;
        }
    };
    for (signature, entries) in structure.signatures.iter().zip(&sums.signatures) {
        let columns = &signature.columns;
        match &signature.local {
            None => {
                let side = columns.len() + 1;
                for (a, &row) in columns.iter().enumerate().filter(|&(_, &row)| row != HELD) {
                    for (b, &column) in columns.iter().enumerate().skip(a) {
                        add(row, column, entries[a * side + b]);
                    }
                }
            }
            Some(local) => {
                let column = |column: u32| columns.get(column as usize).copied().unwrap_or(HELD);
                for (&[a, b], &part) in local.entries.iter().zip(entries) {
                    add(column(a), column(b), part);
                }
            }
        }
    }
}

/// Adds the sums over terms to the entries of a sparse system.
fn add_sparse(structure: &Structure, sums: &ReducedSums, values: &mut [f64]) {
    let places = structure.sparse.iter().flat_map(|pattern| &pattern.signatures);
    for ((signature, places), entries) in structure.signatures.iter().zip(places).zip(&sums.signatures) {
        let mut add = |place: u32, part: f64| {
            if place != NOWHERE {
                values[place as usize] += part;
            }
        };
        if signature.local.is_some() {
            places.iter().zip(entries).for_each(|(&place, &part)| add(place, part));
            continue;
        }
        let n = signature.columns.len();
        let mut places = places.iter();
        for (a, row) in entries.chunks_exact(n + 1).take(n).enumerate() {
            row[a..n].iter().zip(&mut places).for_each(|(&part, &place)| add(place, part));
        }
    }
}
