//! The end of a search along the model that it has: steps from gradients alone.
//!
//! Near the optimum the factored model of one point serves for the next ones too, and a gradient costs
//! a small part of a model and its factorization. What the model lacks - that it is some steps old, and
//! the rows' second derivatives times their residuals, which Gauss and Newton leave out - is learnt from
//! how gradients change: limited-memory BFGS (Nocedal 1980) that starts from the factored model.

use crate::linearization::{Linearization, SIDE};
use crate::problem::Problem;
use crate::step::StepSolver;
use crate::structure::Structure;
use crate::threads::Threads;

/// Steps to learn from, after which a new model is made.
const MAX_PAIRS: usize = 12;

/// A step is good, and the model kept, if the cost falls by this share of what was predicted.
const LEAST_GAIN: f64 = 0.25;

/// A search along a kept model.
#[derive(Debug)]
pub(crate) struct KeptModel {
    /// Where the search is, by all tangent columns.
    gradient: Vec<f64>,
    /// The cost there.
    pub cost: f64,
    pairs: Vec<Pair>,
    pub origin: Origin,
}

/// Where a kept model was made: the search takes the same steps from there again.
#[derive(Debug)]
pub(crate) struct Origin {
    pub values: Vec<f64>,
    /// The steps that had been taken before.
    pub iterations: usize,
    /// The decrease that the last of them promised.
    pub promised: f64,
}

/// A step and what it changed.
#[derive(Debug)]
struct Pair {
    step: Vec<f64>,
    change: Vec<f64>,
    product: f64,
}

impl KeptModel {
    /// Returns a search that stands where the model was made.
    pub(crate) fn new(structure: &Structure, model: &Linearization, origin: Origin) -> Self {
        let mut gradient = vec![0.0; structure.n_columns];
        for (full, column) in structure.each_reduced() {
            gradient[full] = model.reduced.gradient[column];
        }
        for (group, sums) in structure.groups.iter().zip(model.groups()) {
            if let Some(block) = group.eliminated {
                gradient[structure.first_column[block]..][..SIDE].copy_from_slice(&sums.gradient);
            }
        }
        Self { gradient, cost: model.cost(), pairs: Vec::new(), origin }
    }

    /// Tells whether there is no room to learn more.
    pub(crate) fn is_full(&self) -> bool {
        self.pairs.len() >= MAX_PAIRS
    }

    /// Moves on if `step`, of which `predicted` was expected, leads to a good `cost`; tells whether it does.
    pub(crate) fn accept(&mut self, step: &[f64], predicted: f64, cost: f64, gradient: &[f64]) -> bool {
        let is_good = self.cost - cost > LEAST_GAIN * predicted;
        if is_good {
            let change: Vec<f64> = gradient.iter().zip(&self.gradient).map(|(new, old)| new - old).collect();
            let product = dot(step, &change);
            // Where the cost does not curve upwards there is nothing to learn.
            if product > 0.0 {
                self.pairs.push(Pair { step: step.to_vec(), change, product });
            }
            self.gradient.copy_from_slice(gradient);
            self.cost = cost;
        }
        is_good
    }

    /// Writes the next step, and returns the decrease of the cost that it should bring.
    pub(crate) fn step(
        &self,
        problem: &Problem<'_>,
        structure: &Structure,
        model: &Linearization,
        threads: &Threads,
        steps: &mut StepSolver,
        step: &mut Vec<f64>,
    ) -> f64 {
        step.clear();
        step.extend(self.gradient.iter().map(|gradient| -gradient));
        let mut shares = Vec::with_capacity(self.pairs.len());
        for pair in self.pairs.iter().rev() {
            let share = dot(&pair.step, step) / pair.product;
            add_scaled(step, -share, &pair.change);
            shares.push(share);
        }
        steps.apply_inverse(problem, structure, model, threads, step);
        for (pair, share) in self.pairs.iter().zip(shares.iter().rev()) {
            let other = dot(&pair.change, step) / pair.product;
            add_scaled(step, share - other, &pair.step);
        }
        -dot(&self.gradient, step)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add_scaled(sum: &mut [f64], factor: f64, part: &[f64]) {
    sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += factor * part);
}
