//! Beliefs held beforehand: a mean and sigmas, for a block of numbers or a pose.

use boresight_geometry::{Matrix6, Pose, Vector3, Vector6, left_jacobian_inverse, skew};

use crate::problem::{BlockId, GramMut, Scratch, Term, TermKind, Values};

/// Independent Gaussian beliefs about some numbers of a vector block.
#[derive(Clone, Debug, PartialEq)]
pub struct VectorPrior {
    block: [BlockId; 1],
    /// The column, what it is believed to be, and the inverse of the sigma.
    rows: Vec<(usize, f64, f64)>,
}

impl VectorPrior {
    /// Returns the prior of `(column, mean, inverse sigma)` rows on `block`; zero believes nothing.
    pub fn new(block: BlockId, rows: Vec<(usize, f64, f64)>) -> Self {
        Self { block: [block], rows }
    }

    /// Returns what is believed of a column: the inverse square of its sigma, zero for nothing.
    pub fn information(&self, block: BlockId, column: usize) -> f64 {
        let rows = self.rows.iter().filter(|row| self.block == [block] && row.0 == column);
        rows.map(|(_, _, inverse_sigma)| inverse_sigma * inverse_sigma).sum()
    }
}

impl Term for VectorPrior {
    fn blocks(&self) -> &[BlockId] {
        &self.block
    }

    fn kind(&self) -> TermKind {
        TermKind::Prior
    }

    fn row_count(&self) -> usize {
        self.rows.iter().filter(|(_, _, inverse_sigma)| *inverse_sigma != 0.0).count()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let numbers = values.vector(self.block[0]);
        let residual_column = gram.size() - 1;
        let mut cost = 0.0;
        for &(column, mean, inverse_sigma) in &self.rows {
            let residual = (numbers[column] - mean) * inverse_sigma;
            gram.add(column, column, inverse_sigma * inverse_sigma);
            gram.add(column, residual_column, inverse_sigma * residual);
            cost += residual * residual;
        }
        gram.add(residual_column, residual_column, cost);
        Some(cost)
    }
}

/// A Gaussian belief about a pose: independent errors of its rotation vector and its translation.
#[derive(Clone, Debug, PartialEq)]
pub struct PosePrior {
    block: [BlockId; 1],
    mean: Pose,
    inverse_sigmas: [f64; 6],
}

impl PosePrior {
    /// Returns the prior of `mean`, with the inverse sigmas of rotation (1/rad) and translation (1/m);
    /// zero believes nothing.
    pub fn new(block: BlockId, mean: Pose, inverse_sigmas: [f64; 6]) -> Self {
        Self { block: [block], mean, inverse_sigmas }
    }
}

impl Term for PosePrior {
    fn blocks(&self) -> &[BlockId] {
        &self.block
    }

    fn kind(&self) -> TermKind {
        TermKind::Prior
    }

    fn row_count(&self) -> usize {
        self.inverse_sigmas.iter().filter(|inverse_sigma| **inverse_sigma != 0.0).count()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let pose = values.pose(self.block[0]);
        let rotation = Pose::new(pose.rotation * self.mean.rotation.inverse(), Vector3::zeros()).rodrigues();
        let translation = pose.translation - self.mean.translation;
        // A left perturbation (w, v) turns the rotation by w and moves the translation by w × t + v.
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&left_jacobian_inverse(&rotation));
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&pose.translation));
        let mut residual = Vector6::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&rotation);
        residual.fixed_rows_mut::<3>(3).copy_from(&translation);
        for (k, &inverse_sigma) in self.inverse_sigmas.iter().enumerate() {
            residual[k] *= inverse_sigma;
            jacobian.row_mut(k).scale_mut(inverse_sigma);
        }
        let cost = residual.norm_squared();
        let (hessian, gradient) = (jacobian.transpose() * jacobian, jacobian.transpose() * residual);
        for k in 0..6 {
            for l in k..6 {
                gram.add(k, l, hessian[(k, l)]);
            }
            gram.add(k, 6, gradient[k]);
        }
        gram.add(6, 6, cost);
        Some(cost)
    }
}
