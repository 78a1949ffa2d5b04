//! Terms of which each touches few of very many columns, such as views through a splined lens.
//!
//! Such a term does not fill a matrix over all its columns. What does not depend on its eliminated
//! block, it adds to sums that all terms over the same reduced blocks share and whose meaning is
//! theirs; once all are added, one of them tells which entries these sums make up.

use std::ops::Range;

use crate::problem::{BlockId, Scratch, Values};
use crate::structure::Structure;

/// The side of an eliminated block.
const SIDE: usize = Structure::eliminated_columns();

/// A term with local support, over any number of reduced blocks and at most one that is eliminated first.
///
/// Its columns are those of its reduced blocks, in their order; the residual comes behind them.
pub trait LocalTerm: Send + Sync {
    /// Returns the columns that the term may touch at values near `values`, in increasing order.
    /// Only those matter that it touches together with a block that is eliminated first.
    fn support(&self, values: Values<'_>) -> Vec<u32>;

    /// Returns the number of shared sums.
    fn sum_count(&self) -> usize;

    /// Returns the pairs of columns that the shared sums say something of, each once; those with the
    /// residual are the gradient. Where there is an eliminated block, pairs of columns that no term's
    /// support has together are ignored.
    fn entries(&self) -> Vec<[u32; 2]>;

    /// Writes what the shared sums at `values` mean, pair by pair of [`entries`](Self::entries).
    fn expand(&self, values: Values<'_>, sums: &[f64], entries: &mut [f64]);

    /// Returns those columns that measure the same thing in the same unit, such as the knots of a spline.
    /// They are damped alike, for one that few points touch is free to move far.
    fn alike(&self) -> Range<usize> {
        0..0
    }

    /// Adds the gradient by the columns of all of the term's blocks, in their order, and returns the cost,
    /// or `None` where the term is not defined.
    fn gradient(&self, values: Values<'_>, gradient: &mut [f64], scratch: &mut Scratch) -> Option<f64>;

    /// Adds the term to the shared sums and writes what touches its eliminated block.
    fn accumulate(
        &self,
        values: Values<'_>,
        support: &[u32],
        sums: &mut [f64],
        eliminated: &mut EliminatedSums<'_>,
        scratch: &mut Scratch,
    ) -> Accumulated;
}

/// What became of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Accumulated {
    /// All went well; this is the term's cost.
    Cost(f64),
    /// The term is not defined at these values.
    Undefined,
    /// The term touches columns outside the support that was given.
    OutsideSupport,
}

/// `[J r]ᵀ [J r]` of one term, as far as it touches the eliminated block. Everything is zero before.
#[derive(Debug)]
pub struct EliminatedSums<'a> {
    /// The block; `None` for a term that sees none, whose sums here are not used.
    pub block: Option<BlockId>,
    /// The block's own matrix; the upper triangle is read.
    pub own: &'a mut [[f64; SIDE]; SIDE],
    /// The gradient.
    pub gradient: &'a mut [f64; SIDE],
    /// `SIDE` rows over the columns of the support.
    pub coupling: &'a mut [f64],
}
