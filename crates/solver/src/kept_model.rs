//! The end of a search along the model that it has: steps from gradients alone.
//!
//! Near the optimum the factored model of one point serves for the next ones too, and a gradient costs
//! a small part of a model and its factorization. What the model lacks - that it is some steps old, and
//! the rows' second derivatives times their residuals, which Gauss and Newton leave out - is learnt from
//! how gradients change: limited-memory BFGS (Nocedal 1980) that starts from the factored model.

use crate::linearization::{Linearization, SIDE};
use crate::problem::Problem;
use crate::step::{StepSolver, backward, cholesky, damped, forward};
use crate::structure::{HELD, Structure};

/// Steps after which a new model is made.
const MAX_PAIRS: usize = 12;

/// A step is good, and the model kept, if the cost falls by this share of what was predicted.
const LEAST_GAIN: f64 = 0.25;

/// A search along a kept model.
#[derive(Debug)]
pub(crate) struct KeptModel {
    /// The damping that the model was factored with.
    damping: f64,
    /// Where the search is, by all tangent columns.
    gradient: Vec<f64>,
    /// The cost there.
    pub cost: f64,
    pairs: Vec<Pair>,
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
    pub(crate) fn new(structure: &Structure, model: &Linearization, damping: f64) -> Self {
        let mut gradient = vec![0.0; structure.n_columns];
        for (&first, columns) in structure.first_column.iter().zip(&structure.reduced_columns) {
            for (k, &column) in columns.iter().enumerate().filter(|&(_, &column)| column != HELD) {
                gradient[first + k] = model.reduced.gradient[column as usize];
            }
        }
        for (group, sums) in structure.groups.iter().zip(model.groups()) {
            if let Some(block) = group.eliminated {
                gradient[structure.first_column[block]..][..SIDE].copy_from_slice(&sums.gradient);
            }
        }
        Self { damping, gradient, cost: model.cost(), pairs: Vec::new() }
    }

    /// Moves on if `step`, of which `predicted` was expected, leads to a good `cost`; tells whether it does.
    pub(crate) fn accept(&mut self, step: &[f64], predicted: f64, cost: f64, gradient: &[f64]) -> bool {
        let is_good = self.cost - cost > LEAST_GAIN * predicted && self.pairs.len() < MAX_PAIRS;
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
        steps.apply_inverse(problem, structure, model, self.damping, step);
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

impl StepSolver {
    /// Multiplies `x`, by all tangent columns, by the inverse of the factored model.
    fn apply_inverse(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        model: &Linearization,
        damping: f64,
        x: &mut [f64],
    ) {
        let mut reduced = vec![0.0; structure.n_reduced];
        let columns = || structure.first_column.iter().zip(&structure.reduced_columns);
        for (&first, columns) in columns() {
            for (k, &column) in columns.iter().enumerate().filter(|&(_, &column)| column != HELD) {
                reduced[column as usize] = x[first + k];
            }
        }
        let mut triangles = Vec::with_capacity(structure.groups.len());
        for (group, sums) in structure.groups.iter().zip(model.groups()) {
            let block = group.eliminated.map(|block| structure.first_column[block]);
            let Some((first, triangle)) = block.zip(cholesky(&damped(sums, damping))) else {
                triangles.push(None);
                continue;
            };
            let mut own = [0.0; SIDE];
            own.copy_from_slice(&x[first..first + SIDE]);
            forward(&triangle, &mut own);
            backward(&triangle, &mut own);
            let n = group.columns.len();
            for &(place, column, length) in &group.runs {
                for (k, own) in own.iter().enumerate() {
                    add_scaled(
                        &mut reduced[column..column + length],
                        -own,
                        &sums.coupling[k * n + place..][..length],
                    );
                }
            }
            triangles.push(Some((first, triangle)));
        }
        self.reduced.apply_inverse(&mut reduced);
        for (&first, columns) in columns() {
            for (k, &column) in columns.iter().enumerate() {
                x[first + k] = if column == HELD { 0.0 } else { reduced[column as usize] };
            }
        }
        for ((group, sums), triangle) in structure.groups.iter().zip(model.groups()).zip(triangles) {
            let Some((first, triangle)) = triangle else { continue };
            let n = group.columns.len();
            let mut own = [0.0; SIDE];
            own.copy_from_slice(&x[first..first + SIDE]);
            for &(place, column, length) in &group.runs {
                for (k, own) in own.iter_mut().enumerate() {
                    *own -= dot(&sums.coupling[k * n + place..][..length], &reduced[column..column + length]);
                }
            }
            forward(&triangle, &mut own);
            backward(&triangle, &mut own);
            let held = &problem.parameters.blocks[group.eliminated.unwrap_or_default()].held;
            for (k, (own, held)) in own.into_iter().zip(held).enumerate() {
                x[first + k] = if *held { 0.0 } else { own };
            }
        }
    }
}
