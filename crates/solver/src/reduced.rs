//! The reduced system: what is left when the poses of frames are eliminated.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, Par};

use crate::linearization::ReducedSums;
use crate::step::{damping_diagonal, row_stride};
use crate::structure::{HELD, Structure};

/// A dense symmetric system, scaled to a unit diagonal and factored in place.
pub(crate) struct Reduced {
    n: usize,
    /// The system, then its Cholesky factor: lower triangle.
    matrix: Mat<f64>,
    gradient: Vec<f64>,
    /// The diagonal of the system, which factoring overwrites.
    pub(crate) diagonal: Vec<f64>,
    /// The inverse root of the diagonal.
    scale: Vec<f64>,
    scratch: MemBuffer,
    /// The step by reduced column.
    pub step: Vec<f64>,
}

impl Reduced {
    pub(crate) fn new(n: usize) -> Self {
        Self {
            n,
            matrix: Mat::zeros(n, n),
            gradient: vec![0.0; n],
            diagonal: vec![0.0; n],
            scale: vec![1.0; n],
            scratch: MemBuffer::new(cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default())),
            step: vec![0.0; n],
        }
    }

    /// Adds up the system: the sums over terms, the damping, and less what elimination subtracts.
    pub(crate) fn assemble<'p>(
        &mut self,
        structure: &Structure,
        sums: &ReducedSums,
        damping: f64,
        eliminated: impl Iterator<Item = (&'p [f64], &'p [f64])>,
    ) {
        let n = self.n;
        self.matrix.as_mut().fill(0.0);
        self.gradient.copy_from_slice(&sums.gradient);
        for (signature, entries) in structure.signatures.iter().zip(&sums.signatures) {
            let side = signature.columns.len() + 1;
            for (a, &row) in signature.columns.iter().enumerate().filter(|&(_, &row)| row != HELD) {
                for (b, &column) in signature.columns.iter().enumerate().skip(a).filter(|&(_, &c)| c != HELD)
                {
                    let (row, column) = (row.min(column) as usize, row.max(column) as usize);
                    self.matrix[(column, row)] += entries[a * side + b];
                }
            }
        }
        for (column, &diagonal) in sums.diagonal.iter().enumerate() {
            self.matrix[(column, column)] += damping * damping_diagonal(diagonal);
        }
        let stride = row_stride(n);
        // The upper triangle by rows is the lower triangle by columns, which is faer's order.
        for (matrix, gradient) in eliminated {
            for row in 0..n {
                let column = &mut self.matrix.col_as_slice_mut(row)[row..];
                for (entry, part) in column.iter_mut().zip(&matrix[row * stride + row..row * stride + n]) {
                    *entry -= part;
                }
            }
            for (entry, part) in self.gradient.iter_mut().zip(gradient) {
                *entry -= part;
            }
        }
        for (column, diagonal) in self.diagonal.iter_mut().enumerate() {
            *diagonal = self.matrix[(column, column)];
        }
    }

    /// Returns the columns of which elimination left no more than `share` of their diagonal in `sums`.
    ///
    /// The data do not constrain these. Their diagonal is rounding, and scaling would make it a one.
    pub(crate) fn lost_columns(&self, sums: &ReducedSums, share: f64) -> Vec<usize> {
        let kept = |column: usize| self.diagonal[column] > share * sums.diagonal[column];
        (0..self.n).filter(|&column| !kept(column)).collect()
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
        for column in 0..n {
            let by_column = self.scale[column];
            let entries = &mut self.matrix.col_as_slice_mut(column)[column..];
            for (entry, by_row) in entries.iter_mut().zip(&self.scale[column..]) {
                *entry *= by_column * by_row;
            }
        }
        let stack = MemStack::new(&mut self.scratch);
        cholesky_in_place(self.matrix.as_mut(), Default::default(), Par::Seq, stack, Default::default())
            .is_ok()
    }

    /// Solves the factored system for the step that cancels the gradient.
    pub(crate) fn solve(&mut self) {
        for (step, (gradient, scale)) in self.step.iter_mut().zip(self.gradient.iter().zip(&self.scale)) {
            *step = -gradient * scale;
        }
        let mut right = faer::MatMut::from_column_major_slice_mut(&mut self.step, self.n, 1);
        solve_lower_triangular_in_place(self.matrix.as_ref(), right.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(self.matrix.as_ref().transpose(), right.as_mut(), Par::Seq);
        for (step, scale) in self.step.iter_mut().zip(&self.scale) {
            *step *= scale;
        }
    }

    /// Returns the inverse of the factored system.
    pub(crate) fn inverse(&self) -> Mat<f64> {
        let n = self.n;
        let mut inverse = Mat::<f64>::identity(n, n);
        solve_lower_triangular_in_place(self.matrix.as_ref(), inverse.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(self.matrix.as_ref().transpose(), inverse.as_mut(), Par::Seq);
        for column in 0..n {
            for row in 0..n {
                inverse[(row, column)] *= self.scale[row] * self.scale[column];
            }
        }
        inverse
    }

    /// Returns an estimate of the scaled system's reciprocal condition and its loosest direction,
    /// by inverse iteration on the factor.
    pub(crate) fn loosest_direction(&self) -> (f64, Vec<f64>) {
        let n = self.n;
        let mut direction: Vec<f64> = (0..n).map(|i| 1.0 + (i as f64 * 0.618_034).fract()).collect();
        let mut smallest = 1.0;
        for _ in 0..8 {
            let norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
            direction.iter_mut().for_each(|x| *x /= norm);
            let mut right = faer::MatMut::from_column_major_slice_mut(&mut direction, n, 1);
            solve_lower_triangular_in_place(self.matrix.as_ref(), right.as_mut(), Par::Seq);
            solve_upper_triangular_in_place(self.matrix.as_ref().transpose(), right.as_mut(), Par::Seq);
            smallest = 1.0 / direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        }
        // The largest eigenvalue of a matrix with a unit diagonal is between one and its size.
        (smallest / n as f64, direction)
    }
}
