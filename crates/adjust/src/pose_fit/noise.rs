//! The noise of poses: a covariance and how heavy the tails are.

use std::ops::Range;

use boresight_geometry::{Matrix6, Vector6};

use crate::rejection::median;

/// The noise of poses as their residuals tell it, in the camera's frame, rotation first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseNoise {
    /// The scale matrix: the covariance of what is not far off.
    pub scale: Matrix6<f64>,
    /// The degrees of freedom of the t distribution; infinite for a normal one.
    pub degrees_of_freedom: f64,
    inverse: Matrix6<f64>,
}

/// The choices of degrees of freedom.
const CHOICES: [f64; 7] = [2.0, 3.0, 5.0, 8.0, 15.0, 40.0, f64::INFINITY];
const MAX_ROUNDS: usize = 200;
/// Rounds end when no sigma changes by more than this share any more.
const SETTLED_BELOW: f64 = 1e-5;
/// Variances below which a component counts as exact: 1e-9 radians, 1e-9 m.
const LEAST_VARIANCE: f64 = 1e-18;

/// Of fewer rows only the sizes of turns and shifts are told. The unknowns of a fit can bring one direction of a few rows
/// to zero, and a covariance of its own for each direction would be the more likely the smaller it is there.
const LEAST_ROWS: usize = 30;

/// Finds the most likely noise of residuals again and again, each time from where it was last.
///
/// The most likely scale is where a convex function ends (Kent & Tyler 1991), so that the start does not matter, but
/// saves rounds; and of the choices of degrees of freedom only the neighbours of the last one are looked at, as long
/// as these are no better.
#[derive(Clone, Debug, Default)]
pub(super) struct NoiseSearch {
    /// The noise that was found last for each choice.
    known: [Option<PoseNoise>; CHOICES.len()],
    best: Option<usize>,
}

impl NoiseSearch {
    /// Returns the most likely noise of residuals, whose squares fits have made smaller by `redundancy`.
    pub(super) fn of_all_choices(&mut self, residuals: &[Vector6<f64>], redundancy: f64) -> PoseNoise {
        self.descended(0..CHOICES.len(), residuals, redundancy)
    }

    /// Returns the same where the last choice and its neighbours are looked at first, and others only where these are
    /// better.
    pub(super) fn of_near_choices(&mut self, residuals: &[Vector6<f64>], redundancy: f64) -> PoseNoise {
        let near = self.best.map_or(0..CHOICES.len(), neighbours);
        self.descended(near, residuals, redundancy)
    }

    fn descended(&mut self, first: Range<usize>, residuals: &[Vector6<f64>], redundancy: f64) -> PoseNoise {
        let mut costs: [Option<f64>; CHOICES.len()] = [None; CHOICES.len()];
        let mut choices = first;
        let mut best = None;
        loop {
            for choice in choices {
                if costs[choice].is_none() {
                    let found = self.settled(choice, residuals, redundancy);
                    costs[choice] = Some(found.likelihood_cost(residuals));
                    self.known[choice] = Some(found);
                }
            }
            let cost = |choice: &usize| costs[*choice].unwrap_or(f64::INFINITY);
            let least = (0..CHOICES.len()).min_by(|one, other| cost(one).total_cmp(&cost(other)));
            if least == best {
                break;
            }
            best = least;
            choices = best.map_or(0..0, neighbours);
        }
        self.best = best;
        let found = best.and_then(|best| self.known[best]);
        found.unwrap_or_else(|| PoseNoise::new(PoseNoise::spread(residuals), f64::INFINITY))
    }

    /// Returns the noise of one choice, from what was found for it last, or for its neighbour.
    fn settled(&self, choice: usize, residuals: &[Vector6<f64>], redundancy: f64) -> PoseNoise {
        let degrees_of_freedom = CHOICES[choice];
        let near = self.known[choice].or_else(|| self.known[choice.checked_sub(1)?]);
        let start = near.map_or_else(|| PoseNoise::spread(residuals), |near| near.scale);
        let mut noise = PoseNoise::new(start, degrees_of_freedom);
        // What the weights add up to where the scale fits: all of six numbers a row, less what fits have taken.
        let share = (1.0 + 6.0 * (1.0 - redundancy) / degrees_of_freedom) / redundancy;
        for _ in 0..MAX_ROUNDS {
            // Expectation and maximisation with the parameter that speeds it (Liu, Rubin & Wu 1998): rows that are
            // far off count less, and the sum is divided by the weights rather than by the number of rows. The error
            // shrinks by 2 / (degrees + 8) in a round, where the plain way's shrinks by 8 / (degrees + 8).
            let (mut sum, mut weights) = (Matrix6::zeros(), 0.0);
            for residual in residuals {
                let weight = noise.weight(noise.square(residual));
                sum += residual * (residual * weight).transpose();
                weights += weight;
            }
            let mut scale = sum * (share / weights);
            if residuals.len() < LEAST_ROWS {
                scale = pooled(&scale);
            }
            let next = PoseNoise::new(scale, degrees_of_freedom);
            let changed = noise.changed(&next);
            noise = next;
            if changed < SETTLED_BELOW || degrees_of_freedom.is_infinite() {
                break;
            }
        }
        noise
    }
}

/// Returns the indices of a choice and of those beside it.
fn neighbours(choice: usize) -> Range<usize> {
    choice.saturating_sub(1)..(choice + 2).min(CHOICES.len())
}

/// Returns a covariance with one variance of all turns and one of all shifts.
fn pooled(scale: &Matrix6<f64>) -> Matrix6<f64> {
    let mean = |first: usize| (0..3).map(|i| scale[(first + i, first + i)]).sum::<f64>() / 3.0;
    let (turn, shift) = (mean(0), mean(3));
    Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, shift, shift, shift))
}

impl PoseNoise {
    pub(super) fn new(scale: Matrix6<f64>, degrees_of_freedom: f64) -> Self {
        let mut scale = scale;
        for i in 0..6 {
            scale[(i, i)] += LEAST_VARIANCE;
        }
        let inverse = scale.cholesky().map(|factor| factor.inverse());
        // Too few rows for six numbers: each counts for itself.
        let apart = || Matrix6::from_diagonal(&scale.diagonal().map(|variance| 1.0 / variance));
        Self { scale, degrees_of_freedom, inverse: inverse.unwrap_or_else(apart) }
    }

    /// Returns the variances by the median of each component's size, which outliers do not move.
    fn spread(residuals: &[Vector6<f64>]) -> Matrix6<f64> {
        let variances = Vector6::from_fn(|i, _| {
            let mut sizes: Vec<f64> = residuals.iter().map(|residual| residual[i].abs()).collect();
            (median(&mut sizes) / 0.6745).powi(2) + LEAST_VARIANCE
        });
        Matrix6::from_diagonal(&variances)
    }

    pub(super) fn inverse(&self) -> Matrix6<f64> {
        self.inverse
    }

    /// Returns a residual's square in units of the scale.
    pub(super) fn square(&self, residual: &Vector6<f64>) -> f64 {
        residual.dot(&(self.inverse * residual))
    }

    /// Returns how much a residual of this square counts.
    pub(super) fn weight(&self, square: f64) -> f64 {
        let degrees = self.degrees_of_freedom;
        if degrees.is_finite() { (degrees + 6.0) / (degrees + square) } else { 1.0 }
    }

    /// Returns the negative logarithm of a residual's likelihood, up to what depends on the noise alone.
    pub(super) fn cost(&self, square: f64) -> f64 {
        let degrees = self.degrees_of_freedom;
        if degrees.is_finite() { 0.5 * (degrees + 6.0) * (square / degrees).ln_1p() } else { 0.5 * square }
    }

    /// Returns the negative logarithm of the likelihood of all residuals, up to a constant.
    pub(super) fn likelihood_cost(&self, residuals: &[Vector6<f64>]) -> f64 {
        let n = residuals.len() as f64;
        let half = 0.5 * self.degrees_of_freedom;
        // Γ(h + 3) / (Γ(h) h³) = (1 + 1 / h) (1 + 2 / h), which is one for a normal distribution.
        let norm = if half.is_finite() { (1.0 + 1.0 / half).ln() + (1.0 + 2.0 / half).ln() } else { 0.0 };
        let costs: f64 = residuals.iter().map(|residual| self.cost(self.square(residual))).sum();
        costs + n * (0.5 * self.scale.determinant().ln() - norm)
    }

    /// Returns the largest relative change of a component's sigma.
    pub(super) fn changed(&self, next: &Self) -> f64 {
        let ratios = (0..6).map(|i| ((next.scale[(i, i)] / self.scale[(i, i)]).sqrt() - 1.0).abs());
        ratios.fold(0.0, f64::max)
    }

    /// Returns the sigmas of the rotation in radians, about the camera's x, y and z.
    pub fn rotation_sigmas_rad(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| self.scale[(i, i)].sqrt())
    }

    /// Returns the sigmas of the position in metres, along the camera's x, y and z.
    pub fn translation_sigmas_m(&self) -> [f64; 3] {
        [3, 4, 5].map(|i| self.scale[(i, i)].sqrt())
    }
}
