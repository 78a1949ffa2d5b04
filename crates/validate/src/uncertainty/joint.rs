//! The joint covariance of parameters and motions, by name.

use std::collections::BTreeMap;

use boresight_data::Uncertainty;

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
        let information = &self.uncertainty.regularization_information;
        if self.propagation == Propagation::ObservationsOnly && self.uncertainty.noise_factor > 0.0 {
            // With M the sum of squares' matrix and R the regularisation's part of it, noise of the
            // observations alone leaves M⁻¹ (M - R) M⁻¹ = M⁻¹ - M⁻¹ R M⁻¹; all times the noise's square.
            let per_noise = self.uncertainty.noise_factor.powi(-2);
            for (believed, weight) in information.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
                let with: Vec<f64> = places.iter().map(|&place| self.entry(place, believed)).collect();
                let entries = with.iter().flat_map(|a| with.iter().map(move |b| a * b));
                block.iter_mut().zip(entries).for_each(|(entry, part)| *entry -= weight * per_noise * part);
            }
        }
        block
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
