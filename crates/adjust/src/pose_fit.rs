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

use boresight_geometry::nalgebra::{DMatrix, DVector, Matrix6xX};
use boresight_geometry::{Matrix6, Pose, Vector6, left_jacobian_inverse, skew};

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
    /// For each row, seen less predicted: the rotation vector of what is left, and the difference of
    /// positions, in the camera's frame; `None` where the model predicts nothing.
    pub residuals: Vec<Option<Vector6<f64>>>,
    /// For each row, how many sigmas it is off: the root of the residual's square in units of the covariance.
    pub sigmas: Vec<Option<f64>>,
    /// The same residuals when the row's block is left out of the fit.
    pub held_out: Vec<Option<Vector6<f64>>>,
    /// The covariance of the unknowns, by the scatter of the fits without one block each.
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
    let mut noise = search.noise(&residuals_of(&model, seen, &all), redundancy);
    let mut is_converged = false;
    for _ in 0..MAX_ROUNDS {
        let (next, moved) = descended(&model, seen, &all, &noise)?;
        model = next;
        let next = search.noise(&residuals_of(&model, seen, &all), redundancy);
        let changed = noise.changed(&next);
        noise = next;
        if moved < 1e-2 && changed < 1e-3 {
            is_converged = true;
            break;
        }
    }
    let residuals: Vec<Option<Vector6<f64>>> = (0..seen.len()).map(|row| missed(&model, seen, row)).collect();
    let sigmas = residuals.iter().map(|residual| residual.map(|r| noise.square(&r).sqrt())).collect();
    let mut held_out = vec![None; seen.len()];
    let mut names: Vec<usize> = all.iter().map(|&row| block_of_row[row]).collect();
    names.dedup();
    names.sort_unstable();
    names.dedup();
    let n = model.columns();
    let mut moves: Vec<DVector<f64>> = Vec::new();
    for &name in &names {
        let (own, others): (Vec<usize>, Vec<usize>) = all.iter().partition(|&&row| block_of_row[row] == name);
        let Ok((without, total)) = refitted(&model, seen, &others, &noise) else { continue };
        for row in own {
            held_out[row] = missed(&without, seen, row);
        }
        moves.push(total);
    }
    // Efron & Stein 1981: (B - 1) / B times the sum of squares.
    let count = moves.len() as f64;
    let mean = moves.iter().fold(DVector::zeros(n), |sum, moved| sum + moved) / count.max(1.0);
    let mut covariance = DMatrix::zeros(n, n);
    for moved in &moves {
        let off = moved - &mean;
        covariance += &off * off.transpose() * ((count - 1.0) / count);
    }
    let blocks = moves.len();
    Ok(PoseFit { model, noise, residuals, sigmas, held_out, covariance, blocks, is_converged })
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
    let rotation = residual.fixed_rows::<3>(0).into_owned();
    // A left perturbation (w, v) turns by w and moves the translation by w × t + v.
    let mut by_tangent = Matrix6::<f64>::zeros();
    by_tangent.fixed_view_mut::<3, 3>(0, 0).copy_from(&left_jacobian_inverse(&rotation));
    by_tangent.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&predicted.translation));
    by_tangent.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
    for mut column in by_unknowns.column_iter_mut() {
        let moved = by_tangent * &column;
        column.copy_from(&moved);
    }
    Some(residual)
}

fn residuals_of<M: PoseModel>(model: &M, seen: &[Pose], rows: &[usize]) -> Vec<Vector6<f64>> {
    rows.iter().filter_map(|&row| missed(model, seen, row)).collect()
}

/// Returns the negative logarithm of the likelihood of rows, up to what does not depend on the model.
fn cost<M: PoseModel>(model: &M, seen: &[Pose], rows: &[usize], noise: &PoseNoise) -> f64 {
    rows.iter()
        .filter_map(|&row| missed(model, seen, row))
        .map(|residual| noise.cost(noise.square(&residual)))
        .sum()
}

/// Returns the model after steps down the likelihood, and the last step's length in its own sigmas.
fn descended<M: PoseModel>(
    model: &M,
    seen: &[Pose],
    rows: &[usize],
    noise: &PoseNoise,
) -> Result<(M, f64), PoseFitError> {
    let (end, total, normal) = searched(model, seen, rows, noise)?;
    let length = total.dot(&(normal * &total)).max(0.0).sqrt();
    Ok((end, length))
}

/// Returns the model that rows ask for, with the sum of its steps.
fn refitted<M: PoseModel>(
    model: &M,
    seen: &[Pose],
    rows: &[usize],
    noise: &PoseNoise,
) -> Result<(M, DVector<f64>), PoseFitError> {
    let (end, total, _) = searched(model, seen, rows, noise)?;
    Ok((end, total))
}

/// Levenberg and Marquardt's search with the weights of the noise: the end, the sum of steps, the normal matrix.
fn searched<M: PoseModel>(
    begin: &M,
    seen: &[Pose],
    rows: &[usize],
    noise: &PoseNoise,
) -> Result<(M, DVector<f64>, DMatrix<f64>), PoseFitError> {
    let n = begin.columns();
    let weight: Matrix6<f64> = noise.inverse();
    let mut model = begin.clone();
    let mut total = DVector::zeros(n);
    let mut damping = 1e-6;
    let mut present = cost(&model, seen, rows, noise);
    let mut normal = DMatrix::zeros(n, n);
    let mut gradient = DVector::zeros(n);
    let mut jacobian = Matrix6xX::zeros(n);
    for _ in 0..MAX_STEPS {
        normal.fill(0.0);
        gradient.fill(0.0);
        for &row in rows {
            let Some(residual) = residual(&model, seen, row, &mut jacobian) else { continue };
            let weight = weight * noise.weight(noise.square(&residual));
            for a in 0..n {
                let weighted = weight * jacobian.column(a);
                gradient[a] += weighted.dot(&residual);
                for b in a..n {
                    normal[(b, a)] += weighted.dot(&jacobian.column(b));
                }
            }
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let diagonal = normal.diagonal();
        if !diagonal.iter().all(|entry| *entry > 0.0) {
            return Err(PoseFitError::Open);
        }
        let step = loop {
            let mut damped = normal.clone();
            for i in 0..n {
                damped[(i, i)] += damping * diagonal[i];
            }
            let step = -damped.cholesky().ok_or(PoseFitError::Open)?.solve(&gradient);
            let next = model.moved(&step);
            let lower = cost(&next, seen, rows, noise);
            if lower <= present {
                (model, present) = (next, lower);
                damping = (damping * 0.1).max(1e-12);
                break Some(step);
            }
            damping *= 10.0;
            if damping > 1e6 {
                break None;
            }
        };
        let Some(step) = step else { break };
        let length = step.dot(&(&normal * &step)).max(0.0).sqrt();
        total += step;
        if length < SETTLED_SIGMAS {
            break;
        }
    }
    // What rounding alone keeps apart is open.
    let scale = normal.diagonal().map(|entry| 1.0 / entry.sqrt());
    let scaled = DMatrix::from_fn(n, n, |a, b| normal[(a, b)] * scale[a] * scale[b]);
    let least = scaled.symmetric_eigenvalues().min();
    if least.is_nan() || least <= LEAST_EIGENVALUE {
        return Err(PoseFitError::Open);
    }
    Ok((model, total, normal))
}

/// The least eigenvalue of the normal matrix, scaled to a diagonal of ones, with which unknowns are told apart.
const LEAST_EIGENVALUE: f64 = 1e-11;

#[cfg(test)]
mod tests;
