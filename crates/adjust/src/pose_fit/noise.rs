//! The noise of poses: a covariance and how heavy the tails are.

use boresight_geometry::{Matrix6, Vector6};

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
/// Variances below which a component counts as exact: 1e-9 radians, 1e-9 m.
const LEAST_VARIANCE: f64 = 1e-18;

impl PoseNoise {
    /// Returns the most likely noise of residuals, whose squares fits have made smaller by `redundancy`.
    pub(super) fn of(residuals: &[Vector6<f64>], redundancy: f64) -> Self {
        let start = Self::spread(residuals);
        let found = CHOICES.map(|degrees_of_freedom| {
            let mut noise = Self::new(start, degrees_of_freedom);
            for _ in 0..MAX_ROUNDS {
                // Expectation and maximisation: rows that are far off count less.
                let mut sum = Matrix6::zeros();
                for residual in residuals {
                    sum += residual * residual.transpose() * noise.weight(noise.square(residual));
                }
                let next = Self::new(sum / (residuals.len() as f64 * redundancy), degrees_of_freedom);
                let changed = noise.changed(&next);
                noise = next;
                if changed < 1e-5 {
                    break;
                }
            }
            (noise.likelihood_cost(residuals), noise)
        });
        let best = found.into_iter().min_by(|one, other| one.0.total_cmp(&other.0));
        best.map_or_else(|| Self::new(start, f64::INFINITY), |(_, noise)| noise)
    }

    fn new(scale: Matrix6<f64>, degrees_of_freedom: f64) -> Self {
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
            sizes.sort_by(f64::total_cmp);
            let median = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
            (median / 0.6745).powi(2) + LEAST_VARIANCE
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
    fn likelihood_cost(&self, residuals: &[Vector6<f64>]) -> f64 {
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
