//! Beliefs about few at a time of very many numbers.

use std::collections::BTreeMap;

use crate::local::{Accumulated, EliminatedSums, LocalTerm};
use crate::problem::{BlockId, GramMut, Scratch, Term, TermKind, Values};

/// A belief that a weighted sum of numbers is near some value.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Columns of the block and their factors, divided by the belief's sigma.
    pub factors: Vec<(usize, f64)>,
    /// What the sum is believed to be, divided by the sigma.
    pub mean: f64,
}

/// Independent Gaussian beliefs about a vector block of so many numbers that a matrix over all of them
/// would be too large.
#[derive(Clone, Debug, PartialEq)]
pub struct SparsePrior {
    block: [BlockId; 1],
    n_columns: usize,
    beliefs: Vec<Belief>,
    /// The products of columns, which do not depend on the values.
    products: BTreeMap<[u32; 2], f64>,
    /// The columns that any belief is about.
    columns: Vec<u32>,
}

impl SparsePrior {
    /// Returns the prior of `beliefs` on `block`, which has `n_columns` numbers.
    pub fn new(block: BlockId, n_columns: usize, beliefs: Vec<Belief>) -> Self {
        let mut products = BTreeMap::new();
        for Belief { factors, .. } in &beliefs {
            for (k, &(a, by_a)) in factors.iter().enumerate() {
                for &(b, by_b) in &factors[k..] {
                    *products.entry([a.min(b) as u32, a.max(b) as u32]).or_insert(0.0) += by_a * by_b;
                }
            }
        }
        let columns = products.keys().filter(|[a, b]| a == b).map(|[a, _]| *a).collect();
        Self { block: [block], n_columns, beliefs, products, columns }
    }

    /// Returns the entries of the upper triangle of the beliefs' matrix: the inverse squares of sigmas, and products.
    pub fn information(&self) -> impl Iterator<Item = ([usize; 2], f64)> {
        self.products.iter().map(|(&[a, b], &entry)| ([a as usize, b as usize], entry))
    }

    /// Returns what it adds to the cost at `values`.
    pub fn cost(&self, values: Values<'_>) -> f64 {
        self.cost_and_gradient(values).0
    }

    /// Returns the cost, and the gradient by column.
    fn cost_and_gradient(&self, values: Values<'_>) -> (f64, Vec<f64>) {
        let numbers = values.vector(self.block[0]);
        let mut gradient = vec![0.0; self.n_columns];
        let mut cost = 0.0;
        for Belief { factors, mean } in &self.beliefs {
            let sum: f64 = factors.iter().map(|&(column, factor)| factor * numbers[column]).sum();
            let residual = sum - mean;
            cost += residual * residual;
            factors.iter().for_each(|&(column, factor)| gradient[column] += factor * residual);
        }
        (cost, gradient)
    }
}

impl Term for SparsePrior {
    fn blocks(&self) -> &[BlockId] {
        &self.block
    }

    fn kind(&self) -> TermKind {
        TermKind::Prior
    }

    fn row_count(&self) -> usize {
        self.beliefs.len()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let residual_column = gram.size() - 1;
        let (cost, gradient) = self.cost_and_gradient(values);
        self.products.iter().for_each(|(&[a, b], product)| gram.add(a as usize, b as usize, *product));
        gradient.iter().enumerate().for_each(|(column, entry)| gram.add(column, residual_column, *entry));
        gram.add(residual_column, residual_column, cost);
        Some(cost)
    }

    fn local(&self) -> Option<&dyn LocalTerm> {
        Some(self)
    }
}

impl LocalTerm for SparsePrior {
    fn support(&self, _: Values<'_>) -> Vec<u32> {
        Vec::new()
    }

    fn sum_count(&self) -> usize {
        0
    }

    fn entries(&self) -> Vec<[u32; 2]> {
        let gradient = self.columns.iter().map(|&column| [column, self.n_columns as u32]);
        self.products.keys().copied().chain(gradient).collect()
    }

    fn expand(&self, values: Values<'_>, _: &[f64], entries: &mut [f64]) {
        let (_, gradient) = self.cost_and_gradient(values);
        let gradient = self.columns.iter().map(|&column| gradient[column as usize]);
        for (entry, value) in entries.iter_mut().zip(self.products.values().copied().chain(gradient)) {
            *entry = value;
        }
    }

    fn gradient(&self, values: Values<'_>, gradient: &mut [f64], _: &mut Scratch) -> Option<f64> {
        let (cost, own) = self.cost_and_gradient(values);
        gradient.iter_mut().zip(own).for_each(|(sum, part)| *sum += part);
        Some(cost)
    }

    fn accumulate(
        &self,
        values: Values<'_>,
        _: &[u32],
        _: &mut [f64],
        _: &mut EliminatedSums<'_>,
        _: &mut Scratch,
    ) -> Accumulated {
        Accumulated::Cost(self.cost_and_gradient(values).0)
    }
}
