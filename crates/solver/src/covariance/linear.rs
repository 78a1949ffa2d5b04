//! Linear functions of the unknowns, eliminated blocks included, and how well they are known.

use std::collections::BTreeMap;

use super::Covariance;
use crate::linearization::SIDE;
use crate::problem::BlockId;
use crate::structure::HELD;

/// Some linear functions of the perturbations of blocks: `y = sum over blocks of weights * d`.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearFunctions {
    n_functions: usize,
    /// For each block, its weights: a row of the block's columns for each function.
    weights: BTreeMap<BlockId, Vec<f64>>,
}

impl LinearFunctions {
    /// Returns `n_functions` functions that do not depend on anything yet.
    pub fn new(n_functions: usize) -> Self {
        Self { n_functions, weights: BTreeMap::new() }
    }

    /// Returns the number of functions.
    pub fn len(&self) -> usize {
        self.n_functions
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.n_functions == 0
    }

    /// Adds to the weights of functions from `first` on: `rows` holds a row of the block's `n_columns`
    /// columns for each.
    ///
    /// # Panics
    /// If the rows are not whole, go beyond the last function, or were of another width before.
    pub fn add(&mut self, first: usize, block: BlockId, n_columns: usize, rows: &[f64]) {
        assert!(
            rows.len().is_multiple_of(n_columns) && first + rows.len() / n_columns <= self.n_functions,
            "rows are of functions that exist"
        );
        let weights = self.weights.entry(block).or_insert_with(|| vec![0.0; self.n_functions * n_columns]);
        assert_eq!(weights.len(), self.n_functions * n_columns, "a block keeps its width");
        for (weight, part) in weights[first * n_columns..].iter_mut().zip(rows) {
            *weight += part;
        }
    }
}

impl Covariance {
    /// Returns the covariances of linear functions: for each a row of those with `columns`, followed
    /// by those with each function. Held columns do not vary.
    ///
    /// With `x` the reduced unknowns, an eliminated block is `-V⁻¹ W x + e`, where the `e` of different
    /// blocks are independent with covariance `V⁻¹`. So `y = D x + noise`, and with the covariance C of
    /// x the rows are `[D C, D C Dᵀ + N]`.
    pub fn of_functions(&self, functions: &LinearFunctions, columns: &[(BlockId, usize)]) -> Vec<f64> {
        let n = self.structure.n_reduced;
        let n_functions = functions.len();
        let mut dependence = vec![0.0; n_functions * n];
        let mut noise = vec![0.0; n_functions * n_functions];
        for (block, weights) in &functions.weights {
            if let Some(eliminated) = &self.eliminated[block.0] {
                add_eliminated(eliminated, weights, n, &mut dependence, &mut noise);
                continue;
            }
            let reduced_columns = &self.structure.reduced_columns[block.0];
            for (row, weights) in weights.chunks_exact(reduced_columns.len().max(1)).enumerate() {
                for (&column, weight) in reduced_columns.iter().zip(weights) {
                    if column != HELD {
                        dependence[row * n + column as usize] += weight;
                    }
                }
            }
        }
        let mut spread = vec![0.0; n_functions * n];
        for (spread, weights) in spread.chunks_exact_mut(n.max(1)).zip(dependence.chunks_exact(n.max(1))) {
            self.reduced.multiply(weights, spread);
        }
        let mut rows = Vec::with_capacity(n_functions * (columns.len() + n_functions));
        for row in 0..n_functions {
            let with_columns = &spread[row * n..(row + 1) * n];
            rows.extend(
                columns
                    .iter()
                    .map(|&place| self.reduced_column(place).map_or(0.0, |column| with_columns[column])),
            );
            for other in 0..n_functions {
                // From the lower triangle for both, so that the matrix is symmetric to the last bit.
                let (a, b) = (row.max(other), row.min(other));
                let carried = dot(&spread[a * n..(a + 1) * n], &dependence[b * n..(b + 1) * n]);
                rows.push(carried + noise[a * n_functions + b]);
            }
        }
        rows
    }
}

/// Adds what the functions inherit from one eliminated block.
fn add_eliminated(
    eliminated: &super::Eliminated,
    weights: &[f64],
    n: usize,
    dependence: &mut [f64],
    noise: &mut [f64],
) {
    let n_functions = weights.len() / SIDE;
    let n_coupled = eliminated.columns.len();
    let is_used = |row: usize| weights[row * SIDE..(row + 1) * SIDE].iter().any(|weight| *weight != 0.0);
    // Most functions are of few blocks.
    let used: Vec<usize> = (0..n_functions).filter(|&row| is_used(row)).collect();
    for &row in &used {
        let weights_of_row = &weights[row * SIDE..(row + 1) * SIDE];
        let target = &mut dependence[row * n..(row + 1) * n];
        for (k, weight) in weights_of_row.iter().enumerate() {
            let by_column = &eliminated.dependence[k * n_coupled..(k + 1) * n_coupled];
            for (&column, entry) in eliminated.columns.iter().zip(by_column) {
                target[column as usize] -= weight * entry;
            }
        }
        let mut spread = [0.0; SIDE];
        for (l, spread) in spread.iter_mut().enumerate() {
            for (k, weight) in weights_of_row.iter().enumerate() {
                *spread += weight * eliminated.own_inverse[k][l];
            }
        }
        for &other in &used {
            noise[row * n_functions + other] += dot(&spread, &weights[other * SIDE..(other + 1) * SIDE]);
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
