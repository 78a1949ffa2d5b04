//! The joint covariance of parameters and motions, by name.

use std::collections::BTreeMap;

use boresight_data::Uncertainty;
use boresight_geometry::nalgebra::DMatrix;

use super::Propagation;
use crate::Error;

/// A calibration's joint covariance: parameters first, then motions.
#[derive(Debug)]
pub(crate) struct Joint<'a> {
    uncertainty: &'a Uncertainty,
    places: BTreeMap<&'a str, usize>,
    propagation: Propagation,
}

impl<'a> Joint<'a> {
    /// Returns the joint covariance, or why there is none.
    pub(crate) fn new(uncertainty: &'a Uncertainty, propagation: Propagation) -> Result<Self, Error> {
        let (n, n_motions) = (uncertainty.names.len(), uncertainty.motions.names.len());
        let is_whole = uncertainty.covariance.len() == n * n
            && uncertainty.motions.covariance.len() == n_motions * (n + n_motions);
        if let Some(why) = &uncertainty.unavailable {
            return Err(Error::NoCovariance { why: why.clone() });
        }
        if n == 0 || !is_whole {
            return Err(Error::NoCovariance { why: "the calibration holds none".to_owned() });
        }
        let names = uncertainty.names.iter().chain(&uncertainty.motions.names);
        let places = names.enumerate().map(|(i, name)| (name.as_str(), i)).collect();
        Ok(Self { uncertainty, places, propagation })
    }

    /// Returns the place of a parameter or motion; `None` if it is held or unknown.
    pub(crate) fn place(&self, name: &str) -> Option<usize> {
        self.places.get(name).copied()
    }

    /// Returns the covariance of some places, row by row.
    pub(crate) fn block(&self, places: &[usize]) -> Vec<f64> {
        let mut block: Vec<f64> =
            places.iter().flat_map(|&a| places.iter().map(move |&b| self.entry(a, b))).collect();
        if self.propagation == Propagation::ObservationsOnly && self.uncertainty.noise_factor > 0.0 {
            self.take_out_beliefs(places, &mut block);
        }
        block
    }

    /// Takes out of the covariance of some places what is but believed.
    ///
    /// With M the sum of squares' matrix and R the regularisation's part of it, noise of the observations alone
    /// leaves `M⁻¹ (M - R) M⁻¹ = M⁻¹ - M⁻¹ R M⁻¹`, all times the noise's square.
    fn take_out_beliefs(&self, places: &[usize], block: &mut [f64]) {
        let single = self.uncertainty.regularization_information.iter().enumerate();
        let single = single.map(|(place, weight)| (place, place, *weight));
        let pairs = self.uncertainty.regularization_pairs.iter().copied();
        let entries: Vec<(usize, usize, f64)> =
            single.chain(pairs).filter(|(.., weight)| *weight != 0.0).collect();
        let mut believed: Vec<usize> = entries.iter().flat_map(|&(a, b, _)| [a, b]).collect();
        believed.sort_unstable();
        believed.dedup();
        let column = |place: usize| believed.partition_point(|&known| known < place);
        let n = places.len();
        let with = DMatrix::from_fn(n, believed.len(), |i, j| self.entry(places[i], believed[j]));
        let mut weighed = DMatrix::<f64>::zeros(n, believed.len());
        let mut add = |from: usize, to: usize, weight: f64| {
            weighed.column_mut(column(to)).axpy(weight, &with.column(column(from)), 1.0);
        };
        for &(a, b, weight) in &entries {
            add(a, b, weight);
            if a != b {
                add(b, a, weight);
            }
        }
        let part = weighed * with.transpose() * self.uncertainty.noise_factor.powi(-2);
        for (i, row) in block.chunks_exact_mut(n.max(1)).enumerate() {
            row.iter_mut().enumerate().for_each(|(j, entry)| *entry -= part[(i, j)]);
        }
    }

    fn entry(&self, a: usize, b: usize) -> f64 {
        let (low, high) = (a.min(b), a.max(b));
        let n = self.uncertainty.names.len();
        if high < n {
            self.uncertainty.covariance[low * n + high]
        } else {
            let motions = &self.uncertainty.motions;
            motions.covariance[(high - n) * (n + motions.names.len()) + low]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_believed_of_pairs_is_taken_out_too() {
        let noise_factor = 0.5;
        let covariance = [[0.8, 0.3], [0.3, 0.6]];
        let believed = [[0.5, -0.2], [-0.2, 0.4]];
        let uncertainty = Uncertainty {
            noise_factor,
            names: vec!["a".to_owned(), "b".to_owned()],
            covariance: covariance.concat(),
            regularization_information: vec![believed[0][0], believed[1][1]],
            regularization_pairs: vec![(0, 1, believed[0][1])],
            ..Uncertainty::default()
        };
        let joint = Joint::new(&uncertainty, Propagation::ObservationsOnly).unwrap();
        let found = joint.block(&[1, 0]);
        for (i, a) in [1, 0].into_iter().enumerate() {
            for (j, b) in [1, 0].into_iter().enumerate() {
                let mut expected = covariance[a][b];
                for (k, row) in believed.iter().enumerate() {
                    for (l, entry) in row.iter().enumerate() {
                        expected -=
                            covariance[a][k] * entry * covariance[l][b] / (noise_factor * noise_factor);
                    }
                }
                assert!((found[2 * i + j] - expected).abs() < 1e-15, "{} {expected}", found[2 * i + j]);
            }
        }
    }
}
