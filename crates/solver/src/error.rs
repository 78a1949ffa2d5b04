//! What can keep a problem from being solved.

use crate::BlockId;
use crate::linearization::Failure;

/// Why a problem was not solved.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A term names a block that the problem does not have.
    #[error("term {term_idx} names block {block}, which the problem does not have")]
    UnknownBlock {
        /// The term.
        term_idx: usize,
        /// The block it names.
        block: usize,
    },
    /// A term names a block twice.
    #[error("term {term_idx} names block {block} twice")]
    RepeatedBlock {
        /// The term.
        term_idx: usize,
        /// The block it names twice.
        block: usize,
    },
    /// A term sees two blocks that are both to be eliminated first.
    #[error("term {term_idx} sees blocks {} and {}, which are both to be eliminated first", blocks[0], blocks[1])]
    TwoEliminatedBlocks {
        /// The term.
        term_idx: usize,
        /// The blocks.
        blocks: [usize; 2],
    },
    /// A first value is NaN or infinite.
    #[error("value {value_idx} of the start is {value}; all must be finite")]
    NotFinite {
        /// The value's index.
        value_idx: usize,
        /// The value.
        value: f64,
    },
    /// A term is not defined at the values given.
    #[error("term {term_idx} is not defined at the start, such as by a point behind its camera")]
    UndefinedStart {
        /// The first such term, in the order of evaluation.
        term_idx: usize,
    },
    /// A term with local support touches columns outside the support that it named at these very values.
    #[error("a term touches columns outside the support that it named at the same values")]
    OutsideSupport,
    /// There are fewer rows than unknowns.
    #[error("{unknowns} unknowns against {rows} rows of observations and priors")]
    TooFewRows {
        /// The number of rows.
        rows: usize,
        /// The number of unknowns.
        unknowns: usize,
    },
    /// The covariance does not exist, because a direction of the parameters is not constrained.
    #[error(
        "the data do not constrain the parameters: reciprocal condition {reciprocal_condition:.1e} is below {limit:.1e}; the loosest direction mixes reduced columns {columns:?}"
    )]
    Singular {
        /// The reciprocal condition of the scaled reduced system.
        reciprocal_condition: f64,
        /// What it was held against.
        limit: f64,
        /// The reduced columns that the loosest direction moves most, with their shares.
        columns: Vec<(usize, f64)>,
    },
    /// The covariance does not exist, because a block that is eliminated first is not constrained,
    /// even if all others were known.
    #[error("the data do not constrain block {}, whatever the other blocks are", block.0)]
    LooseBlock {
        /// The block.
        block: BlockId,
    },
    /// A checkpoint could not be read or written, or belongs to another problem.
    #[error("checkpoint {path}: {problem}")]
    Checkpoint {
        /// The file.
        path: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The requested number of threads could not be started.
    #[error("could not start {threads} threads: {problem}")]
    Threads {
        /// The number asked for.
        threads: usize,
        /// What the system said.
        problem: String,
    },
}

impl From<Failure> for Error {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Undefined { term_idx } => Self::UndefinedStart { term_idx },
            Failure::OutsideSupport => Self::OutsideSupport,
        }
    }
}
