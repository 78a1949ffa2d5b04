//! What is to be solved: parameter blocks, what of them is held, and the terms of the sum of squares.

use std::ops::Range;

use boresight_geometry::nalgebra::{Dim, Matrix, Quaternion, Storage, Vector};
use boresight_geometry::{Pose, UnitQuaternion, Vector3, Vector6};

use crate::Error;
use crate::aligned::Aligned;
use crate::composite::{CompositeTerm, Links};
use crate::gram::PairGram;
use crate::local::LocalTerm;

/// A parameter block of a problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BlockId(pub(crate) usize);

/// How a block's values move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Manifold {
    /// Numbers that add.
    Vector,
    /// A pose: seven numbers, perturbed on the left by six.
    Pose,
}

/// When a block is solved for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elimination {
    /// First, by its Schur complement. No term may see two such blocks, and it has six columns.
    First,
    /// With all the others, in the reduced system.
    Reduced,
}

#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub manifold: Manifold,
    pub elimination: Elimination,
    /// Where its values start.
    pub start: usize,
    /// The number of its tangent columns, held ones included.
    pub n_columns: usize,
    /// Which tangent columns are held fixed.
    pub held: Vec<bool>,
}

impl Block {
    pub(crate) fn n_values(&self) -> usize {
        match self.manifold {
            Manifold::Vector => self.n_columns,
            Manifold::Pose => POSE_VALUES,
        }
    }
}

pub(crate) const POSE_VALUES: usize = 7;
/// A pose's first values: its quaternion.
const ROTATION_VALUES: usize = 4;
pub(crate) const POSE_COLUMNS: usize = 6;

/// The blocks of a problem and their first values.
#[derive(Clone, Debug, Default)]
pub struct Parameters {
    pub(crate) blocks: Vec<Block>,
    pub(crate) values: Vec<f64>,
}

/// The values of all blocks, at some point of the search.
#[derive(Clone, Copy, Debug)]
pub struct Values<'a> {
    pub(crate) blocks: &'a [Block],
    pub(crate) values: &'a [f64],
}

impl Parameters {
    /// Adds a block of numbers.
    pub fn add_vector(&mut self, values: &[f64]) -> BlockId {
        self.add(Manifold::Vector, Elimination::Reduced, values.len(), values)
    }

    /// Adds a pose.
    pub fn add_pose(&mut self, pose: &Pose, elimination: Elimination) -> BlockId {
        self.add(Manifold::Pose, elimination, POSE_COLUMNS, &pose_values(pose))
    }

    fn add(
        &mut self,
        manifold: Manifold,
        elimination: Elimination,
        n_columns: usize,
        values: &[f64],
    ) -> BlockId {
        let start = self.values.len();
        self.values.extend_from_slice(values);
        self.blocks.push(Block { manifold, elimination, start, n_columns, held: vec![false; n_columns] });
        BlockId(self.blocks.len() - 1)
    }

    /// Holds one tangent column of a block at its first value.
    ///
    /// A pose's columns are perturbations on the left, so its rotation is fixed by holding the first
    /// three together, but a translation whose columns are held still turns with a free rotation.
    ///
    /// # Panics
    /// If there is no such column.
    pub fn hold(&mut self, block: BlockId, column: usize) {
        self.blocks[block.0].held[column] = true;
    }

    /// Holds a whole block.
    pub fn hold_all(&mut self, block: BlockId) {
        self.blocks[block.0].held.fill(true);
    }

    /// Tells whether a column is held.
    pub fn is_held(&self, block: BlockId, column: usize) -> bool {
        self.blocks[block.0].held[column]
    }

    /// Replaces the first values, for example by a solution's.
    ///
    /// # Panics
    /// If their number is another.
    pub fn set_values(&mut self, values: &[f64]) {
        self.values.copy_from_slice(values);
    }

    /// Returns the first values.
    pub fn values(&self) -> Values<'_> {
        self.at(&self.values)
    }

    /// Returns `values` as the values of these blocks.
    pub fn at<'a>(&'a self, values: &'a [f64]) -> Values<'a> {
        Values { blocks: &self.blocks, values }
    }

    /// Returns the number of columns that are free.
    pub fn free_count(&self) -> usize {
        self.blocks.iter().flat_map(|block| &block.held).filter(|held| !**held).count()
    }

    /// Returns the number of all tangent columns, held ones included.
    pub fn column_count(&self) -> usize {
        self.blocks.iter().map(|block| block.n_columns).sum()
    }

    /// Returns which of all tangent columns, held ones included, are a block's.
    pub fn columns(&self, block: BlockId) -> Range<usize> {
        let start = self.blocks[..block.0].iter().map(|block| block.n_columns).sum();
        start..start + self.blocks[block.0].n_columns
    }

    /// Writes into `moved` the values that `step` (all tangent columns, held ones included) leads to.
    pub fn retract(&self, values: &[f64], step: &[f64], moved: &mut Vec<f64>) {
        moved.clear();
        moved.extend_from_slice(values);
        let mut column = 0;
        for block in &self.blocks {
            let step = &step[column..column + block.n_columns];
            column += block.n_columns;
            match block.manifold {
                Manifold::Vector => {
                    for (value, step) in moved[block.start..].iter_mut().zip(step) {
                        // Adding zero would turn the sign of a held -0.0.
                        if *step != 0.0 {
                            *value += step;
                        }
                    }
                }
                Manifold::Pose => {
                    // An untouched pose keeps its very bits.
                    if step.iter().any(|step| *step != 0.0) {
                        let pose =
                            self.at(values).pose_of(block).perturbed(&Vector6::from_column_slice(step));
                        // Normalising anew must not touch a rotation that is held.
                        let first =
                            if step[..3].iter().all(|step| *step == 0.0) { ROTATION_VALUES } else { 0 };
                        moved[block.start..][first..POSE_VALUES]
                            .copy_from_slice(&pose_values(&pose)[first..]);
                    }
                }
            }
        }
    }
}

impl<'a> Values<'a> {
    /// Returns the numbers of a vector block.
    pub fn vector(&self, block: BlockId) -> &'a [f64] {
        let block = &self.blocks[block.0];
        &self.values[block.start..block.start + block.n_columns]
    }

    /// Returns the pose of a pose block.
    pub fn pose(&self, block: BlockId) -> Pose {
        self.pose_of(&self.blocks[block.0])
    }

    /// Returns all numbers, block after block.
    pub fn as_slice(&self) -> &'a [f64] {
        self.values
    }

    fn pose_of(&self, block: &Block) -> Pose {
        let v = &self.values[block.start..block.start + POSE_VALUES];
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(v[3], v[0], v[1], v[2]));
        Pose::new(rotation, Vector3::new(v[4], v[5], v[6]))
    }
}

fn pose_values(pose: &Pose) -> [f64; POSE_VALUES] {
    let q = pose.rotation.coords;
    [q.x, q.y, q.z, q.w, pose.translation.x, pose.translation.y, pose.translation.z]
}

/// What a term contributes to the sum of squares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TermKind {
    /// Something measured; counts for the noise estimate.
    Observation,
    /// Something believed beforehand; does not.
    Prior,
}

/// A term of the sum of squares.
pub trait Term: Send + Sync {
    /// Returns the blocks that the term depends on, each once; its columns are theirs in this order.
    fn blocks(&self) -> &[BlockId];

    /// Returns what the term stands for.
    fn kind(&self) -> TermKind {
        TermKind::Observation
    }

    /// Returns the number of rows of residuals that count.
    fn row_count(&self) -> usize;

    /// Writes `[J r]ᵀ [J r]` at `values` to the whole upper triangle of `gram`, which holds anything
    /// before, and returns the term's cost; or returns `None` where the term is not defined, and the
    /// solver then rejects the step.
    ///
    /// The cost is the sum of squared residuals; with a robust loss it is the loss, and J and r are
    /// scaled by the root of its weight. `scratch` is the term's to use and keeps its size.
    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, scratch: &mut Scratch) -> Option<f64>;

    /// Returns the term as one whose poses act through one composite pose, for which there is a shorter
    /// way than [`linearize`](Self::linearize), if it is such a term.
    fn composite(&self) -> Option<&dyn CompositeTerm> {
        None
    }

    /// Returns the term as one that touches few of its columns, if it is; it is then evaluated as that.
    fn local(&self) -> Option<&dyn LocalTerm> {
        None
    }
}

/// The square matrix that a term writes to: its columns in order, then the residual.
#[derive(Debug)]
pub struct GramMut<'a> {
    entries: &'a mut [f64],
    n: usize,
}

impl<'a> GramMut<'a> {
    /// Returns the first `n * n` numbers of `entries` as a matrix.
    pub fn new(entries: &'a mut [f64], n: usize) -> Self {
        Self { entries: &mut entries[..n * n], n }
    }

    /// Returns the number of columns, the residual included.
    pub fn size(&self) -> usize {
        self.n
    }

    /// Sets the upper triangle to zero.
    pub fn clear(&mut self) {
        for a in 0..self.n {
            self.row_mut(a)[a..].fill(0.0);
        }
    }

    /// Adds `value` at (`a`, `b`), in either order.
    #[inline(always)]
    pub fn add(&mut self, a: usize, b: usize, value: f64) {
        self.entries[a.min(b) * self.n + a.max(b)] += value;
    }

    /// Adds the products of rows `[J r]`, and returns the sum of the squares of `residuals`.
    ///
    /// Columns of `jacobian` behind those of the term are left out.
    pub fn add_rows<R: Dim, C: Dim>(
        &mut self,
        jacobian: &Matrix<f64, R, C, impl Storage<f64, R, C>>,
        residuals: &Vector<f64, R, impl Storage<f64, R>>,
    ) -> f64 {
        let last = self.n - 1;
        for a in 0..last {
            for b in a..last {
                self.add(a, b, jacobian.column(a).dot(&jacobian.column(b)));
            }
            self.add(a, last, jacobian.column(a).dot(residuals));
        }
        let cost = residuals.norm_squared();
        self.add(last, last, cost);
        cost
    }

    /// Returns row `a`; entries left of the diagonal are not used.
    #[inline(always)]
    pub fn row_mut(&mut self, a: usize) -> &mut [f64] {
        &mut self.entries[a * self.n..(a + 1) * self.n]
    }
}

/// Room for a term to work in, kept between evaluations so that nothing is allocated inside them.
///
/// No two share a cache line, nor two that are fetched together: threads that write to one wait for each other.
#[derive(Debug, Default)]
#[repr(align(128))]
pub struct Scratch {
    /// Rows of `[J r]`, wherever the term wants them.
    pub rows: Aligned,
    /// Sums of products.
    pub gram: PairGram,
    /// The maps of a chain's links.
    pub links: Links,
    /// Rows of the composite pose.
    pub(crate) pose_rows: Aligned,
    /// Rows of a link.
    pub(crate) link_rows: Aligned,
}

/// Parameters and terms: a sum of squares to be made least.
pub struct Problem<'a> {
    pub(crate) parameters: &'a Parameters,
    pub(crate) terms: Vec<&'a dyn Term>,
}

impl<'a> Problem<'a> {
    /// Returns the problem of these terms, after checking that their blocks exist, that those marked
    /// to be eliminated first can be, and that all values are finite.
    pub fn new(parameters: &'a Parameters, terms: Vec<&'a dyn Term>) -> Result<Self, Error> {
        for (term_idx, term) in terms.iter().enumerate() {
            let mut eliminated = None;
            for (place, &block) in term.blocks().iter().enumerate() {
                if term.blocks()[..place].contains(&block) {
                    return Err(Error::RepeatedBlock { term_idx, block: block.0 });
                }
                let Some(found) = parameters.blocks.get(block.0) else {
                    return Err(Error::UnknownBlock { term_idx, block: block.0 });
                };
                if found.elimination == Elimination::First {
                    if let Some(other) = eliminated {
                        return Err(Error::TwoEliminatedBlocks { term_idx, blocks: [other, block.0] });
                    }
                    eliminated = Some(block.0);
                }
            }
        }
        if let Some(value_idx) = parameters.values.iter().position(|value| !value.is_finite()) {
            return Err(Error::NotFinite { value_idx, value: parameters.values[value_idx] });
        }
        Ok(Self { parameters, terms })
    }

    /// Returns the number of rows of observations.
    pub fn observation_rows(&self) -> usize {
        self.terms
            .iter()
            .filter(|term| term.kind() == TermKind::Observation)
            .map(|term| term.row_count())
            .sum()
    }
}
