//! Beliefs held beforehand: a mean and sigmas, for a block of numbers or a pose.

use boresight_geometry::nalgebra::{DMatrix, DVector};
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

    /// Returns what it adds to the cost at `values`.
    pub fn cost(&self, values: Values<'_>) -> f64 {
        let numbers = values.vector(self.block[0]);
        let residual =
            |&(column, mean, inverse_sigma): &(usize, f64, f64)| (numbers[column] - mean) * inverse_sigma;
        self.rows.iter().map(|row| residual(row).powi(2)).sum()
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
        Some(gram.add_rows(&jacobian, &residual))
    }
}

/// What a [`JointPrior`] believes of a block.
#[derive(Clone, Debug, PartialEq)]
pub enum JointBelief {
    /// Numbers of a vector block: columns with their means.
    Numbers(BlockId, Vec<(usize, f64)>),
    /// A pose: six columns, left perturbations of the mean in the order rotation, translation.
    Pose(BlockId, Pose),
}

/// A Gaussian belief about numbers and poses of several blocks at once, with their covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPrior {
    blocks: Vec<BlockId>,
    beliefs: Vec<JointBelief>,
    /// The inverse of the covariance.
    information: DMatrix<f64>,
}

impl JointPrior {
    /// Returns the prior of `beliefs`, each about a block of its own, with the covariance of their columns
    /// in this order; `None` if that is not square and positive definite. Only its lower triangle is read.
    pub fn new(beliefs: Vec<JointBelief>, covariance: &DMatrix<f64>) -> Option<Self> {
        let n: usize = beliefs.iter().map(JointBelief::column_count).sum();
        if covariance.shape() != (n, n) {
            return None;
        }
        // Parameters differ by many powers of ten: factored with a unit diagonal.
        let sigmas: Vec<f64> = (0..n).map(|i| covariance[(i, i)].sqrt()).collect();
        if !sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0) {
            return None;
        }
        let scaled = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (sigmas[i] * sigmas[j]));
        let inverse = scaled.cholesky()?.inverse();
        let information = DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / (sigmas[i] * sigmas[j]));
        let blocks = beliefs.iter().map(JointBelief::block).collect();
        Some(Self { blocks, beliefs, information })
    }
}

impl JointBelief {
    fn block(&self) -> BlockId {
        match self {
            JointBelief::Numbers(block, _) | JointBelief::Pose(block, _) => *block,
        }
    }

    fn column_count(&self) -> usize {
        match self {
            JointBelief::Numbers(_, numbers) => numbers.len(),
            JointBelief::Pose(..) => 6,
        }
    }
}

impl Term for JointPrior {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn kind(&self) -> TermKind {
        TermKind::Prior
    }

    fn row_count(&self) -> usize {
        self.information.nrows()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let n = self.row_count();
        let last = gram.size() - 1;
        let mut departure = DVector::zeros(n);
        // The column of the gram that each of ours is, and the derivative of the poses' departures by theirs.
        let mut columns = Vec::with_capacity(n);
        let mut by_pose = Vec::new();
        let mut first = 0;
        for belief in &self.beliefs {
            let row = columns.len();
            match belief {
                JointBelief::Numbers(block, numbers) => {
                    let found = values.vector(*block);
                    for (k, &(column, mean)) in numbers.iter().enumerate() {
                        departure[row + k] = found[column] - mean;
                        columns.push(first + column);
                    }
                    first += found.len();
                }
                JointBelief::Pose(block, mean) => {
                    let off = (values.pose(*block) * mean.inverse()).log();
                    departure.fixed_rows_mut::<6>(row).copy_from(&off);
                    by_pose.push((row, log_by_left(&off)));
                    columns.extend(first..first + 6);
                    first += 6;
                }
            }
        }
        // The derivative is the identity for numbers, so that only poses need products.
        let mut gradient = &self.information * &departure;
        let cost = departure.dot(&gradient);
        let mut information = self.information.clone();
        for (row, by_left) in &by_pose {
            let mapped = information.fixed_columns::<6>(*row) * by_left;
            information.fixed_columns_mut::<6>(*row).copy_from(&mapped);
        }
        for (row, by_left) in &by_pose {
            let mapped = by_left.transpose() * information.fixed_rows::<6>(*row);
            information.fixed_rows_mut::<6>(*row).copy_from(&mapped);
            let mapped = by_left.transpose() * gradient.fixed_rows::<6>(*row);
            gradient.fixed_rows_mut::<6>(*row).copy_from(&mapped);
        }
        for (i, &a) in columns.iter().enumerate() {
            for (j, &b) in columns.iter().enumerate().skip(i) {
                gram.add(a.min(b), a.max(b), information[(i, j)]);
            }
            gram.add(a, last, gradient[i]);
        }
        gram.add(last, last, cost);
        Some(cost)
    }
}

/// Returns the derivative of the log of a pose by a left perturbation, where the log is `departure`:
/// `1 - ad/2 + ad²/12`, the series of Solà, Deray & Atchuthan 2018, to the fourth order in a small departure.
fn log_by_left(departure: &Vector6<f64>) -> Matrix6<f64> {
    let turn = skew(&departure.fixed_rows::<3>(0).into_owned());
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&skew(&departure.fixed_rows::<3>(3).into_owned()));
    Matrix6::identity() - adjoint * 0.5 + adjoint * adjoint / 12.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::{Elimination, Parameters};

    #[test]
    fn the_joint_prior_is_its_own_rows() {
        let mean = Pose::from_rodrigues(Vector3::new(0.4, -0.2, 0.1), Vector3::new(0.3, 0.1, 2.0));
        let moved = Vector6::new(0.02, -0.01, 0.03, 0.01, 0.02, -0.015);
        let root =
            DMatrix::from_fn(8, 8, |i, j| if i == j { 0.1 + 0.05 * i as f64 } else { 0.01 * (i + j) as f64 });
        let covariance = &root * root.transpose();
        let case = |numbers: [f64; 3], tangent: Vector6<f64>| {
            let mut parameters = Parameters::default();
            let block = parameters.add_vector(&numbers);
            let pose = parameters.add_pose(&mean.perturbed(&moved).perturbed(&tangent), Elimination::Reduced);
            let beliefs =
                vec![JointBelief::Numbers(block, vec![(2, 5.0), (0, 1.0)]), JointBelief::Pose(pose, mean)];
            let prior = JointPrior::new(beliefs, &covariance).unwrap();
            let mut entries = vec![f64::NAN; 100];
            let mut gram = GramMut::new(&mut entries, 10);
            let cost = prior.linearize(parameters.values(), &mut gram, &mut Scratch::default()).unwrap();
            (cost, entries)
        };
        let (cost, entries) = case([1.3, 7.0, 4.6], Vector6::zeros());
        let mut departure = vec![-0.4, 0.3];
        departure.extend(moved.iter());
        let departure = boresight_geometry::nalgebra::DVector::from_vec(departure);
        let expected = (departure.transpose() * covariance.clone().try_inverse().unwrap() * &departure)[0];
        assert!((cost / expected - 1.0).abs() < 1e-10, "{cost} against {expected}");
        for column in 0..9 {
            let step = 1e-5;
            let at = |sign: f64| {
                let (mut numbers, mut tangent) = ([1.3, 7.0, 4.6], Vector6::zeros());
                if column < 3 {
                    numbers[column] += sign * step
                } else {
                    tangent[column - 3] = sign * step
                }
                case(numbers, tangent).0
            };
            let difference = (at(1.0) - at(-1.0)) / (4.0 * step);
            let gradient = entries[column * 10 + 9];
            // The series ends at the fourth power of 0.05.
            assert!(
                (gradient - difference).abs() < 1e-5 * cost.max(1.0) * 10.0,
                "{column}: {gradient} {difference}"
            );
        }
        let singular = DMatrix::from_element(8, 8, 1.0);
        assert_eq!(JointPrior::new(vec![JointBelief::Pose(BlockId(0), mean)], &singular), None);
    }
}
