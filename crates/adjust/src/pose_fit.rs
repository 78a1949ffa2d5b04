//! Fits to poses that a camera saw of a target, where no pixels are known: any model that predicts them.
//!
//! What such poses err by is not known beforehand: along the line of sight more than across it, about the
//! camera's axes more than about the line of sight, and now and then, when a tracker takes another target or
//! the mirrored pose, by anything. So the covariance of the six numbers is estimated from the residuals, and
//! they follow a multivariate t distribution whose degrees of freedom the likelihood chooses (Lange, Little &
//! Taylor 1989); a normal distribution is one of the choices. Rows follow each other in time and err alike, so
//! that how well anything is known is told by leaving out one block of rows after another.

mod hand_eye;
mod joints;
mod noise;

use std::collections::BTreeMap;

use boresight_geometry::nalgebra::{DMatrix, DVector, Matrix6xX};
use boresight_geometry::{Pose, Vector6};

pub use hand_eye::{Arm, HandEyeModel};
pub use joints::JointModel;
use noise::NoiseSearch;
pub use noise::PoseNoise;

/// What predicts where a camera sees a target.
pub trait PoseModel: Clone {
    /// Returns the number of unknowns.
    fn columns(&self) -> usize;

    /// Returns `rig_from_target` of a row; `None` for a row of which the model tells nothing.
    fn pose(&self, row: usize) -> Option<Pose>;

    /// Returns the same, and writes the derivative of its left tangent by the unknowns, a column for each.
    fn predicted(&self, row: usize, by_unknowns: &mut Matrix6xX<f64>) -> Option<Pose>;

    /// Returns the model moved by a step of its unknowns.
    fn moved(&self, step: &DVector<f64>) -> Self;
}

/// A model fitted to poses.
#[derive(Clone, Debug)]
pub struct PoseFit<M> {
    /// The model.
    pub model: M,
    /// The noise of the poses that were seen.
    pub noise: PoseNoise,
    /// For each row, predicted less seen: the rotation vector of what is left, and the difference of
    /// positions, in the camera's frame; `None` where the model predicts nothing.
    pub residuals: Vec<Option<Vector6<f64>>>,
    /// For each row, how many sigmas it is off: the root of the residual's square in units of the covariance.
    pub sigmas: Vec<Option<f64>>,
    /// The same residuals when the row's block is left out of the fit.
    pub held_out: Vec<Option<Vector6<f64>>>,
    /// The covariance of the unknowns, by the scatter of the fits without one block each; NaN of fewer than two, and
    /// where an unknown hangs on a single block.
    pub covariance: DMatrix<f64>,
    /// The number of blocks.
    pub blocks: usize,
    /// Whether the search ended because nothing changed any more.
    pub is_converged: bool,
}

/// What keeps a model from being fitted to poses.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PoseFitError {
    /// There are too few rows.
    #[error("{found} poses are seen of which the model tells; {need} are needed")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// The rows leave an unknown open.
    #[error("the poses leave an unknown open")]
    Open,
}

/// At most so many rounds of fit and noise.
const MAX_ROUNDS: usize = 60;
const MAX_STEPS: usize = 20;
/// A step below this many of its own sigmas changes nothing.
const SETTLED_SIGMAS: f64 = 1e-4;

/// Fits a model to the poses that were seen, from a start nearby. Rows of one block stand together.
fn fit_poses<M: PoseModel>(
    start: M,
    seen: &[Pose],
    block_of_row: &[usize],
) -> Result<PoseFit<M>, PoseFitError> {
    assert_eq!(seen.len(), block_of_row.len(), "each pose is of a block");
    let all: Vec<usize> = (0..seen.len()).filter(|&row| start.pose(row).is_some()).collect();
    let need = start.columns().div_ceil(6) + 1;
    if all.len() < need {
        return Err(PoseFitError::TooFew { found: all.len(), need });
    }
    // Six numbers of a row, less what the unknowns take from each.
    let redundancy = 1.0 - start.columns() as f64 / (6 * all.len()) as f64;
    let mut model = start;
    let mut search = NoiseSearch::default();
    let mut noise = search.of_all_choices(&residuals_of(&model, seen, &all), redundancy);
    let mut is_converged = false;
    for _ in 0..MAX_ROUNDS {
        let found = searched(&model, seen, &all, &noise)?;
        let moved = found.length();
        model = found.model;
        let residuals = residuals_of(&model, seen, &all);
        let mut next = search.of_near_choices(&residuals, redundancy);
        if moved < 1e-2 && noise.changed(&next) < 1e-3 {
            // Another choice may have become better than all near the last one.
            next = search.of_all_choices(&residuals, redundancy);
            is_converged = noise.changed(&next) < 1e-3;
        }
        noise = next;
        if is_converged {
            break;
        }
    }
    let residuals: Vec<Option<Vector6<f64>>> = (0..seen.len()).map(|row| missed(&model, seen, row)).collect();
    let sigmas = residuals.iter().map(|residual| residual.map(|r| noise.square(&r).sqrt())).collect();
    let left_out = without_blocks(&model, seen, &all, block_of_row, &noise);
    let (blocks, held_out, covariance) = (left_out.blocks, left_out.held_out, left_out.covariance);
    Ok(PoseFit { model, noise, residuals, sigmas, held_out, covariance, blocks, is_converged })
}

/// What fits without one block each tell.
struct LeftOut {
    blocks: usize,
    held_out: Vec<Option<Vector6<f64>>>,
    covariance: DMatrix<f64>,
}

/// Fits the model without one block after another, each from a Newton step ahead of the optimum.
fn without_blocks<M: PoseModel>(
    model: &M,
    seen: &[Pose],
    all: &[usize],
    block_of_row: &[usize],
    noise: &PoseNoise,
) -> LeftOut {
    let mut rows_of_block: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for &row in all {
        rows_of_block.entry(block_of_row[row]).or_default().push(row);
    }
    let n = model.columns();
    let mut held_out = vec![None; seen.len()];
    let mut moves: Vec<DVector<f64>> = Vec::new();
    let mut sums = Sums::zeros(n);
    sums.add(model, seen, all, noise);
    let mut of_block = Sums::zeros(n);
    for (&name, own) in &rows_of_block {
        of_block.clear();
        of_block.add(model, seen, own, noise);
        let (normal, gradient) = (&sums.normal - &of_block.normal, &sums.gradient - &of_block.gradient);
        let ahead = normal.cholesky().map_or_else(|| DVector::zeros(n), |factor| -factor.solve(&gradient));
        let others: Vec<usize> = all.iter().copied().filter(|&row| block_of_row[row] != name).collect();
        let Ok(without) = searched(&model.moved(&ahead), seen, &others, noise) else { continue };
        for &row in own {
            held_out[row] = missed(&without.model, seen, row);
        }
        moves.push(without.total + ahead);
    }
    let count = moves.len() as f64;
    // Without the block that moves them most, the others would seem to agree on what they leave open.
    let is_known = moves.len() >= 2 && moves.len() == rows_of_block.len();
    let mut covariance = DMatrix::from_element(n, n, if is_known { 0.0 } else { f64::NAN });
    // Efron & Stein 1981: (B - 1) / B times the sum of squares.
    let mean = moves.iter().fold(DVector::zeros(n), |sum, moved| sum + moved) / count.max(1.0);
    for moved in &moves {
        let off = moved - &mean;
        covariance += &off * off.transpose() * ((count - 1.0) / count);
    }
    LeftOut { blocks: moves.len(), held_out, covariance }
}

/// Returns a row's residual.
fn missed<M: PoseModel>(model: &M, seen: &[Pose], row: usize) -> Option<Vector6<f64>> {
    Some(difference(&model.pose(row)?, &seen[row]))
}

/// Returns the rotation vector from a seen to a predicted pose, and the difference of their positions.
fn difference(predicted: &Pose, seen: &Pose) -> Vector6<f64> {
    let turn = (predicted.rotation * seen.rotation.inverse()).scaled_axis();
    let off = predicted.translation - seen.translation;
    Vector6::new(turn.x, turn.y, turn.z, off.x, off.y, off.z)
}

/// Returns a row's residual, and writes its derivative by the unknowns.
fn residual<M: PoseModel>(
    model: &M,
    seen: &[Pose],
    row: usize,
    by_unknowns: &mut Matrix6xX<f64>,
) -> Option<Vector6<f64>> {
    let predicted = model.predicted(row, by_unknowns)?;
    let residual = difference(&predicted, &seen[row]);
    let turn = predicted.rotation * seen[row].rotation.inverse();
    let by_tangent = Pose::new(turn, predicted.translation).rodrigues_by_tangent();
    for mut column in by_unknowns.column_iter_mut() {
        let moved = by_tangent * &column;
        column.copy_from(&moved);
    }
    Some(residual)
}

fn residuals_of<M: PoseModel>(model: &M, seen: &[Pose], rows: &[usize]) -> Vec<Vector6<f64>> {
    rows.iter().filter_map(|&row| missed(model, seen, row)).collect()
}

/// Returns the negative logarithm of the likelihood of each row, up to what does not depend on the model.
fn costs<M: PoseModel>(model: &M, seen: &[Pose], rows: &[usize], noise: &PoseNoise) -> Vec<Option<f64>> {
    rows.iter()
        .map(|&row| missed(model, seen, row).map(|residual| noise.cost(noise.square(&residual))))
        .collect()
}

/// Tells whether costs have not grown, over the rows of which both models tell: a step of the clocks' offset takes rows
/// past the recording's end, and what is no longer told of must not count as gained.
fn is_no_worse(present: &[Option<f64>], trial: &[Option<f64>]) -> bool {
    let (mut both, mut change) = (0, 0.0);
    for (present, trial) in present.iter().zip(trial) {
        if let (Some(present), Some(trial)) = (present, trial) {
            both += 1;
            change += trial - present;
        }
    }
    2 * both >= present.len() && change <= 0.0
}

/// Sums over rows: the normal matrix and the gradient, weighted by the noise.
struct Sums {
    normal: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Room for the derivatives of one row.
    jacobian: Matrix6xX<f64>,
}

impl Sums {
    fn zeros(n: usize) -> Self {
        Self { normal: DMatrix::zeros(n, n), gradient: DVector::zeros(n), jacobian: Matrix6xX::zeros(n) }
    }

    fn clear(&mut self) {
        self.normal.fill(0.0);
        self.gradient.fill(0.0);
    }

    fn add<M: PoseModel>(&mut self, model: &M, seen: &[Pose], rows: &[usize], noise: &PoseNoise) {
        let n = self.gradient.len();
        for &row in rows {
            let Some(residual) = residual(model, seen, row, &mut self.jacobian) else { continue };
            let weight = noise.inverse() * noise.weight(noise.square(&residual));
            for a in 0..n {
                let weighted = weight * self.jacobian.column(a);
                self.gradient[a] += weighted.dot(&residual);
                for b in a..n {
                    self.normal[(b, a)] += weighted.dot(&self.jacobian.column(b));
                }
            }
        }
        self.normal.fill_upper_triangle_with_lower_triangle();
    }
}

/// Where a search ended.
struct Searched<M> {
    model: M,
    /// The sum of its steps.
    total: DVector<f64>,
    /// The normal matrix at the last step.
    normal: DMatrix<f64>,
}

impl<M> Searched<M> {
    /// Returns how far the search went, in its own sigmas.
    fn length(&self) -> f64 {
        self.total.dot(&(&self.normal * &self.total)).max(0.0).sqrt()
    }
}

/// Levenberg and Marquardt's search with the weights of the noise.
fn searched<M: PoseModel>(
    begin: &M,
    seen: &[Pose],
    rows: &[usize],
    noise: &PoseNoise,
) -> Result<Searched<M>, PoseFitError> {
    let n = begin.columns();
    let mut model = begin.clone();
    let mut total = DVector::zeros(n);
    let mut damping = 1e-6;
    let mut present = costs(&model, seen, rows, noise);
    let mut sums = Sums::zeros(n);
    for _ in 0..MAX_STEPS {
        sums.clear();
        sums.add(&model, seen, rows, noise);
        let diagonal = sums.normal.diagonal();
        if !diagonal.iter().all(|entry| *entry > 0.0) {
            return Err(PoseFitError::Open);
        }
        let step = loop {
            let mut damped = sums.normal.clone();
            for i in 0..n {
                damped[(i, i)] += damping * diagonal[i];
            }
            let step = -damped.cholesky().ok_or(PoseFitError::Open)?.solve(&sums.gradient);
            let next = model.moved(&step);
            let trial = costs(&next, seen, rows, noise);
            if is_no_worse(&present, &trial) {
                (model, present) = (next, trial);
                damping = (damping * 0.1).max(1e-12);
                break Some(step);
            }
            damping *= 10.0;
            if damping > 1e6 {
                break None;
            }
        };
        let Some(step) = step else { break };
        let length = step.dot(&(&sums.normal * &step)).max(0.0).sqrt();
        total += step;
        if length < SETTLED_SIGMAS {
            break;
        }
    }
    // What rounding alone keeps apart is open.
    let scale = sums.normal.diagonal().map(|entry| 1.0 / entry.sqrt());
    let scaled = DMatrix::from_fn(n, n, |a, b| sums.normal[(a, b)] * scale[a] * scale[b]);
    let least = scaled.symmetric_eigenvalues().min();
    if least.is_nan() || least <= LEAST_EIGENVALUE {
        return Err(PoseFitError::Open);
    }
    Ok(Searched { model, total, normal: sums.normal })
}

/// The least eigenvalue of the normal matrix, scaled to a diagonal of ones, with which unknowns are told apart.
const LEAST_EIGENVALUE: f64 = 1e-11;

#[cfg(test)]
mod tests;
