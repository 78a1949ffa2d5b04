//! The covariance at the optimum, from the factor of the reduced system.

mod linear;

use crate::Error;
use crate::linearization::{GroupSums, Linearization, SIDE};
use crate::options::SolveOptions;
use crate::problem::{BlockId, Elimination, Problem};
use crate::reduced::Inverse;
use crate::step::{StepSolver, backward, cholesky, forward};
use crate::structure::{HELD, Structure};
use crate::threads::Threads;
pub use linear::LinearFunctions;

/// The least reciprocal condition of the scaled reduced system with which its inverse means something: rounding
/// of a hundred times the last bit then changes a sigma by a percent.
const LEAST_RECIPROCAL_CONDITION: f64 = 1e-12;

/// The least reciprocal condition against what was there before elimination: the last bit of that may then change a variance
/// by a tenth. Lenses of 8 to 14 coefficients have sigmas right to 1e-6 down to 8e-15, and wrong by 85 % at 2e-16.
const LEAST_BEFORE_ELIMINATION: f64 = 2e-15;

/// A column of which elimination leaves no more than this share is lost in rounding.
const LOST_SHARE: f64 = 1e-14;

/// The joint covariance of all free columns, for residuals in units of their sigma.
#[derive(Debug)]
pub struct Covariance {
    structure: Structure,
    reduced: Inverse,
    /// The diagonal of the reduced system, by reduced column: what is known of a column if all others are known.
    information: Vec<f64>,
    /// For each eliminated block: its own inverse, and its dependence on the reduced columns.
    eliminated: Vec<Option<Eliminated>>,
    /// The cost of the observations at the optimum.
    pub observation_cost: f64,
    /// The cost of the priors at the optimum.
    pub prior_cost: f64,
}

#[derive(Clone, Debug)]
struct Eliminated {
    own_inverse: [[f64; SIDE]; SIDE],
    /// `own⁻¹ W`, `SIDE` rows over `columns`.
    dependence: Vec<f64>,
    columns: Vec<u32>,
}

/// Returns the covariance of the problem's parameters at `values`, or why there is none.
pub fn covariance(
    problem: &Problem<'_>,
    values: &[f64],
    options: &SolveOptions,
) -> Result<Covariance, Error> {
    covariance_of(problem, Structure::new(problem, values), values, options)
}

/// Returns the covariance of a problem with this structure.
fn covariance_of(
    problem: &Problem<'_>,
    structure: Structure,
    values: &[f64],
    options: &SolveOptions,
) -> Result<Covariance, Error> {
    let mut model = Linearization::new(&structure);
    let rows: usize = problem.terms.iter().map(|term| term.row_count()).sum();
    let threads = Threads::new(options.threads, rows)?;
    model.evaluate(problem, &structure, values, &threads)?;
    for (group, sums) in structure.groups.iter().zip(model.groups()) {
        if let Some(block) = group.eliminated
            && cholesky(&sums.own).is_none()
        {
            return Err(Error::LooseBlock { block: BlockId(block) });
        }
    }
    let mut steps = StepSolver::new(&structure);
    let singular = |reciprocal_condition, limit, direction: Vec<f64>| Error::Singular {
        reciprocal_condition,
        limit,
        columns: dominant(&direction, &structure.natural_columns),
    };
    let is_eliminated = steps.eliminate(&structure, &model, 0.0, &threads);
    let largest = steps.reduced.eigenvalue_bound();
    let factored = is_eliminated && steps.reduced.factor();
    let lost = steps.reduced.lost_columns(&model.reduced, LOST_SHARE);
    if !lost.is_empty() {
        let mut direction = vec![0.0; structure.n_reduced];
        lost.iter().for_each(|&column| direction[column] = 1.0);
        return Err(singular(0.0, LEAST_RECIPROCAL_CONDITION, direction));
    }
    if !factored {
        // A whisper of damping makes the loosest direction visible.
        let direction = if steps.factor(&structure, &model, 1e-10, &threads) {
            steps.reduced.loosest_direction().1
        } else {
            Vec::new()
        };
        return Err(singular(0.0, LEAST_RECIPROCAL_CONDITION, direction));
    }
    let (smallest, direction) = steps.reduced.loosest_direction();
    let cancellation = steps.reduced.cancellation(&model.reduced);
    for (largest, limit) in [(largest, LEAST_RECIPROCAL_CONDITION), (cancellation, LEAST_BEFORE_ELIMINATION)]
    {
        let reciprocal_condition = smallest / largest;
        // NaN is no condition either.
        let conditioned = reciprocal_condition > limit;
        if structure.n_reduced > 0 && !conditioned {
            return Err(singular(reciprocal_condition, limit, direction));
        }
    }
    let mut eliminated = vec![None; problem.parameters.blocks.len()];
    for (group, sums) in structure.groups.iter().zip(model.groups()) {
        if let Some(block) = group.eliminated {
            let held = &problem.parameters.blocks[block].held;
            eliminated[block] = Some(Eliminated::new(sums, &group.columns, held));
        }
    }
    Ok(Covariance {
        information: steps.reduced.diagonal.clone(),
        reduced: steps.reduced.into_inverse(),
        structure,
        eliminated,
        observation_cost: model.observation_cost,
        prior_cost: model.prior_cost,
    })
}

/// Returns the entries of a direction that matter most, with their shares of its square.
fn dominant(direction: &[f64], natural_columns: &[u32]) -> Vec<(usize, f64)> {
    let total: f64 = direction.iter().map(|x| x * x).sum();
    let share = |(x, &column): (&f64, &u32)| (column as usize, x * x / total);
    let mut shares: Vec<(usize, f64)> = direction.iter().zip(natural_columns).map(share).collect();
    shares.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    shares.retain(|(_, share)| *share > 0.05);
    shares.truncate(6);
    shares
}

impl Covariance {
    /// Returns the covariance of columns `(block, column)`; that of held columns is zero.
    ///
    /// Blocks that were eliminated first are not among these; see [`eliminated`](Self::eliminated).
    pub fn between(&self, a: (BlockId, usize), b: (BlockId, usize)) -> f64 {
        match (self.reduced_column(a), self.reduced_column(b)) {
            (Some(a), Some(b)) => self.reduced.entry(a, b),
            _ => 0.0,
        }
    }

    /// Returns the reciprocal variance that a column would have if all other columns but those eliminated
    /// first were known; `None` for a held column or one of an eliminated block.
    ///
    /// Times the column's own variance this is how much the other columns take of what is known of it.
    pub fn information(&self, column: (BlockId, usize)) -> Option<f64> {
        self.reduced_column(column).map(|column| self.information[column])
    }

    /// Returns the block and column of a reduced column, as [`Error::Singular`] names them.
    pub fn column_of(problem: &Problem<'_>, reduced_column: usize) -> Option<(BlockId, usize)> {
        let mut next = 0;
        for (block_idx, block) in problem.parameters.blocks.iter().enumerate() {
            if block.elimination == Elimination::First {
                continue;
            }
            for (column, _) in block.held.iter().enumerate().filter(|(_, held)| !**held) {
                if next == reduced_column {
                    return Some((BlockId(block_idx), column));
                }
                next += 1;
            }
        }
        None
    }

    /// Returns the 6x6 covariance of a block that was eliminated first, row by row, zero for held columns;
    /// `None` if the block is another, or if no term sees it.
    pub fn eliminated(&self, block: BlockId) -> Option<[[f64; SIDE]; SIDE]> {
        // V⁻¹ + (V⁻¹ W) Σ (V⁻¹ W)ᵀ.
        let Eliminated { own_inverse, dependence, columns } = self.eliminated[block.0].as_ref()?;
        let n = columns.len();
        let mut covariance = *own_inverse;
        let mut spread = vec![0.0; SIDE * n];
        for k in 0..SIDE {
            for (place, &column) in columns.iter().enumerate() {
                spread[k * n + place] = (0..n)
                    .map(|other| {
                        dependence[k * n + other]
                            * self.reduced.entry(columns[other] as usize, column as usize)
                    })
                    .sum();
            }
        }
        for k in 0..SIDE {
            for l in 0..SIDE {
                covariance[k][l] +=
                    (0..n).map(|place| spread[k * n + place] * dependence[l * n + place]).sum::<f64>();
            }
        }
        Some(covariance)
    }

    /// Returns the covariance of the columns of a block that was eliminated first with those of a reduced block.
    ///
    /// A row for each of the first's columns; zero where either is held or no term sees the first.
    pub fn eliminated_with(&self, block: BlockId, reduced: BlockId) -> Vec<Vec<f64>> {
        let columns = &self.structure.reduced_columns[reduced.0];
        let mut covariance = vec![vec![0.0; columns.len()]; SIDE];
        let Some(eliminated) = self.eliminated[block.0].as_ref() else { return covariance };
        let n = eliminated.columns.len();
        for (k, row) in covariance.iter_mut().enumerate() {
            for (entry, &column) in row.iter_mut().zip(columns) {
                if column != HELD {
                    // -(V⁻¹ W) Σ.
                    *entry = -(0..n)
                        .map(|other| {
                            let row = eliminated.columns[other] as usize;
                            eliminated.dependence[k * n + other] * self.reduced.entry(row, column as usize)
                        })
                        .sum::<f64>();
                }
            }
        }
        covariance
    }

    fn reduced_column(&self, (block, column): (BlockId, usize)) -> Option<usize> {
        self.structure.reduced_columns[block.0].get(column).filter(|&&c| c != HELD).map(|&c| c as usize)
    }
}

impl Eliminated {
    fn new(sums: &GroupSums, columns: &[u32], held: &[bool]) -> Self {
        let mut own_inverse = [[0.0; SIDE]; SIDE];
        let mut dependence = sums.coupling.clone();
        if let Some(lower) = cholesky(&sums.own) {
            // Held columns have a one on their diagonal, which is not their variance.
            for k in (0..SIDE).filter(|&k| !held[k]) {
                let mut unit = [0.0; SIDE];
                unit[k] = 1.0;
                forward(&lower, &mut unit);
                backward(&lower, &mut unit);
                own_inverse[k] = unit;
            }
            let n = columns.len();
            for place in 0..n {
                let mut column: [f64; SIDE] = std::array::from_fn(|k| sums.coupling[k * n + place]);
                forward(&lower, &mut column);
                backward(&lower, &mut column);
                for (k, entry) in column.iter().enumerate() {
                    dependence[k * n + place] = *entry;
                }
            }
        }
        Self { own_inverse, dependence, columns: columns.to_vec() }
    }
}

#[cfg(test)]
#[path = "covariance/tests.rs"]
mod tests;
