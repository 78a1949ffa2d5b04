//! A sparse reduced system: its supernodal factor, and what is needed of its inverse.

use std::sync::OnceLock;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::sparse::linalg::cholesky::simplicial::{
    prefactorize_symbolic_cholesky, prefactorize_symbolic_cholesky_scratch,
};
use faer::sparse::linalg::cholesky::supernodal::{
    SupernodalLltRef, SymbolicSupernodalCholesky, factorize_supernodal_numeric_llt,
    factorize_supernodal_numeric_llt_scratch, factorize_supernodal_symbolic_cholesky,
    factorize_supernodal_symbolic_cholesky_scratch,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Accum, Conj, Mat, MatMut, Par};

use crate::pattern::Pattern;

/// A sparse symmetric system and its Cholesky factor. The symbolic factorization is done once.
pub(crate) struct SparseSystem {
    symbolic: SymbolicSupernodalCholesky<u32>,
    lower: SymbolicSparseColMat<u32>,
    /// The lower triangle, entry by entry of the pattern.
    pub values: Vec<f64>,
    factor: Vec<f64>,
    scratch: MemBuffer,
}

impl SparseSystem {
    pub(crate) fn new(pattern: &Pattern) -> Self {
        let n = pattern.starts.len() - 1;
        let upper = upper(pattern);
        let mut tree = vec![0_i32; n];
        let mut counts = vec![0_u32; n];
        let n_entries = pattern.n_entries();
        let mut room = MemBuffer::new(StackReq::any_of(&[
            prefactorize_symbolic_cholesky_scratch::<u32>(n, n_entries),
            factorize_supernodal_symbolic_cholesky_scratch::<u32>(n),
        ]));
        let stack = MemStack::new(&mut room);
        let tree = prefactorize_symbolic_cholesky(&mut tree, &mut counts, upper.as_ref(), stack);
        let symbolic =
            factorize_supernodal_symbolic_cholesky(upper.as_ref(), tree, &counts, stack, Default::default())
                .expect("a factor has fewer entries than an index can count");
        let factor = vec![0.0; symbolic.len_val()];
        let scratch = MemBuffer::new(StackReq::any_of(&[
            factorize_supernodal_numeric_llt_scratch::<u32, f64>(&symbolic, Par::Seq, Default::default()),
            symbolic.solve_in_place_scratch::<f64>(1, Par::Seq),
        ]));
        let lower =
            SymbolicSparseColMat::new_checked(n, n, pattern.starts.clone(), None, pattern.rows.clone());
        Self { symbolic, lower, values: vec![0.0; n_entries], factor, scratch }
    }

    /// Returns where a column's diagonal entry is.
    pub(crate) fn diagonal(&self, column: usize) -> usize {
        self.lower.col_ptr()[column] as usize
    }

    /// Calls `visit` with the row, the column and the value of each entry of the lower triangle.
    pub(crate) fn each_entry(&self, mut visit: impl FnMut(usize, usize, f64)) {
        let (starts, rows) = (self.lower.col_ptr(), self.lower.row_idx());
        for (column, range) in starts.windows(2).enumerate() {
            let range = range[0] as usize..range[1] as usize;
            for (&value, &row) in self.values[range.clone()].iter().zip(&rows[range]) {
                visit(row as usize, column, value);
            }
        }
    }

    /// Multiplies each entry by the scales of its row and column.
    pub(crate) fn scale(&mut self, scale: &[f64]) {
        let (starts, rows) = (self.lower.col_ptr(), self.lower.row_idx());
        for (range, by_column) in starts.windows(2).zip(scale) {
            let range = range[0] as usize..range[1] as usize;
            for (value, &row) in self.values[range.clone()].iter_mut().zip(&rows[range]) {
                *value *= by_column * scale[row as usize];
            }
        }
    }

    /// Factors the system; tells whether it is positive definite.
    pub(crate) fn factor(&mut self) -> bool {
        factorize_supernodal_numeric_llt(
            &mut self.factor,
            SparseColMatRef::new(self.lower.as_ref(), &self.values),
            Default::default(),
            &self.symbolic,
            Par::Seq,
            MemStack::new(&mut self.scratch),
            Default::default(),
        )
        .is_ok()
    }

    /// Multiplies a vector by the inverse of the factored system.
    pub(crate) fn solve(&mut self, x: &mut [f64]) {
        solve(&self.symbolic, &self.factor, x, &mut self.scratch);
    }

    /// Returns the inverse of the factored system, whose rows and columns are to be scaled.
    pub(crate) fn into_inverse(self, scale: Vec<f64>) -> SparseInverse {
        SparseInverse::new(self.symbolic, self.factor, scale)
    }
}

fn solve(symbolic: &SymbolicSupernodalCholesky<u32>, factor: &[f64], x: &mut [f64], room: &mut MemBuffer) {
    let n = x.len();
    SupernodalLltRef::new(symbolic, factor).solve_in_place_with_conj(
        Conj::No,
        MatMut::from_column_major_slice_mut(x, n, 1),
        Par::Seq,
        MemStack::new(room),
    );
}

/// Returns the upper triangle by columns, which is the lower triangle by rows.
fn upper(pattern: &Pattern) -> SymbolicSparseColMat<u32> {
    let n = pattern.starts.len() - 1;
    let mut starts = vec![0_u32; n + 1];
    pattern.rows.iter().for_each(|&row| starts[row as usize + 1] += 1);
    for row in 0..n {
        starts[row + 1] += starts[row];
    }
    let mut next = starts.clone();
    let mut columns = vec![0_u32; pattern.n_entries()];
    for (column, range) in pattern.starts.windows(2).enumerate() {
        for &row in &pattern.rows[range[0] as usize..range[1] as usize] {
            columns[next[row as usize] as usize] = column as u32;
            next[row as usize] += 1;
        }
    }
    SymbolicSparseColMat::new_checked(n, n, starts, None, columns)
}

/// The inverse of a sparse system: all entries where its factor has any, and others when asked for.
///
/// The former are found from the last column to the first without any other entry of the inverse
/// (Takahashi, Fagan & Chin 1973), a supernode at a time; the latter take a solve for each column.
#[derive(Debug)]
pub(crate) struct SparseInverse {
    symbolic: SymbolicSupernodalCholesky<u32>,
    factor: Vec<f64>,
    /// The entries, as the factor has them; the diagonal blocks are whole.
    entries: Vec<f64>,
    /// For each column, its supernode.
    supernode_of: Vec<u32>,
    scale: Vec<f64>,
    columns: Vec<OnceLock<Vec<f64>>>,
}

impl SparseInverse {
    fn new(symbolic: SymbolicSupernodalCholesky<u32>, factor: Vec<f64>, scale: Vec<f64>) -> Self {
        let n = symbolic.nrows();
        let mut supernode_of = vec![0; n];
        for (s, (&begin, &end)) in symbolic.supernode_begin().iter().zip(symbolic.supernode_end()).enumerate()
        {
            supernode_of[begin as usize..end as usize].fill(s as u32);
        }
        let mut inverse = Self {
            entries: vec![0.0; factor.len()],
            symbolic,
            factor,
            supernode_of,
            scale,
            columns: (0..n).map(|_| OnceLock::new()).collect(),
        };
        for s in (0..inverse.symbolic.n_supernodes()).rev() {
            inverse.find_supernode(s);
        }
        inverse
    }

    /// Finds the entries of a supernode from those of the later ones.
    fn find_supernode(&mut self, s: usize) {
        let llt = SupernodalLltRef::new(&self.symbolic, &self.factor);
        let node = llt.supernode(s);
        let n_own = node.val().ncols();
        let (own, below) = node.val().split_at_row(n_own);
        let pattern = node.pattern();
        let n_below = pattern.len();
        // With L = [A; B], Y = B A⁻¹ and the inverse Z of what is below: -Z Y is below the diagonal,
        // and A⁻ᵀ A⁻¹ + Yᵀ Z Y on it.
        let mut y_transposed = below.transpose().to_owned();
        solve_upper_triangular_in_place(own.transpose(), y_transposed.as_mut(), Par::Seq);
        let mut known = Mat::zeros(n_below, n_below);
        for (b, &column) in pattern.iter().enumerate() {
            for (a, &row) in pattern.iter().enumerate().skip(b) {
                let entry = self.found(row as usize, column as usize).unwrap_or(0.0);
                known[(a, b)] = entry;
                known[(b, a)] = entry;
            }
        }
        let mut found_below: Mat<f64> = Mat::zeros(n_below, n_own);
        let y = y_transposed.as_ref().transpose();
        matmul(found_below.as_mut(), Accum::Replace, known.as_ref(), y, -1.0, Par::Seq);
        let mut found_own: Mat<f64> = Mat::identity(n_own, n_own);
        solve_lower_triangular_in_place(own, found_own.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(own.transpose(), found_own.as_mut(), Par::Seq);
        matmul(found_own.as_mut(), Accum::Add, y_transposed.as_ref(), found_below.as_ref(), -1.0, Par::Seq);
        let start = self.symbolic.col_ptr_for_val()[s] as usize;
        for (column, target) in self.entries[start..].chunks_mut(n_own + n_below).take(n_own).enumerate() {
            for row in 0..n_own {
                // The two triangles differ by rounding only; the lower one is taken.
                target[row] = found_own[(row.max(column), row.min(column))];
            }
            for row in 0..n_below {
                target[n_own + row] = found_below[(row, column)];
            }
        }
    }

    /// Returns an entry of the scaled inverse, with `row >= column`, if it is where the factor has any.
    fn found(&self, row: usize, column: usize) -> Option<f64> {
        let s = self.supernode_of[column] as usize;
        let node = self.symbolic.supernode(s);
        let end = self.symbolic.supernode_end()[s] as usize;
        let n_own = end - node.start();
        let below = match row < end {
            true => row - node.start(),
            false => n_own + node.pattern().binary_search(&(row as u32)).ok()?,
        };
        let n_rows = n_own + node.pattern().len();
        let start = self.symbolic.col_ptr_for_val()[s] as usize;
        Some(self.entries[start + (column - node.start()) * n_rows + below])
    }

    /// Returns an entry of the inverse.
    pub(crate) fn entry(&self, a: usize, b: usize) -> f64 {
        let (row, column) = (a.max(b), a.min(b));
        let entry = self.found(row, column).unwrap_or_else(|| self.column(column)[row]);
        entry * self.scale[row] * self.scale[column]
    }

    /// Writes the product of the inverse with a vector.
    pub(crate) fn multiply(&self, x: &[f64], product: &mut [f64]) {
        let scaled = x.iter().zip(&self.scale).map(|(x, scale)| x * scale);
        product.iter_mut().zip(scaled).for_each(|(entry, x)| *entry = x);
        let mut room = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        solve(&self.symbolic, &self.factor, product, &mut room);
        product.iter_mut().zip(&self.scale).for_each(|(entry, scale)| *entry *= scale);
    }

    /// Returns a column of the scaled inverse, which is found once.
    fn column(&self, column: usize) -> &[f64] {
        self.columns[column].get_or_init(|| {
            let mut x = vec![0.0; self.columns.len()];
            x[column] = 1.0;
            let mut room = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
            solve(&self.symbolic, &self.factor, &mut x, &mut room);
            x
        })
    }
}
