//! Which observations to leave out: judged anew in each pass, by a scale that outliers cannot move.

use boresight_data::{CameraId, Dataset, Id};

/// The ratio of a Gaussian's sigma to the median of the length of a two-dimensional residual: `1 / sqrt(2 ln 2)`.
const SIGMA_PER_MEDIAN_LENGTH: f64 = 0.849_321_800_288_019;

/// A residual shorter than this, in sigmas, is never an outlier: it is rounding.
pub(crate) const ROUNDING_SIGMAS: f64 = 1e-6;

/// The residuals of all views that take part, in sigmas.
pub(crate) struct Lengths {
    /// For each view that takes part: its index, and the length of each observation's residual;
    /// infinite where the lens does not see the point.
    pub views: Vec<(usize, Vec<f64>)>,
}

impl Lengths {
    /// Returns the robust sigma of each camera's residuals: from the median of their lengths.
    pub(crate) fn scales(&self, dataset: &Dataset) -> Vec<f64> {
        let mut by_camera = vec![Vec::new(); dataset.cameras.len()];
        for (view_idx, lengths) in &self.views {
            by_camera[dataset.views[*view_idx].camera.index()].extend_from_slice(lengths);
        }
        by_camera.iter_mut().map(|lengths| SIGMA_PER_MEDIAN_LENGTH * median(lengths)).collect()
    }

    /// Returns for each view which of its observations are kept.
    pub(crate) fn kept(&self, dataset: &Dataset, scales: &[f64], sigmas: f64) -> Vec<Vec<bool>> {
        let limit = |camera: CameraId| (sigmas * scales[camera.index()]).max(ROUNDING_SIGMAS);
        self.views
            .iter()
            .map(|(view_idx, lengths)| {
                let limit = limit(dataset.views[*view_idx].camera);
                lengths.iter().map(|&length| length <= limit).collect()
            })
            .collect()
    }
}

/// Returns the median, or zero of nothing.
pub(crate) fn median(numbers: &mut [f64]) -> f64 {
    if numbers.is_empty() {
        return 0.0;
    }
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(median(&mut []), 0.0);
        assert_eq!(median(&mut [3.0]), 3.0);
        assert_eq!(median(&mut [5.0, 1.0, 2.0, 9.0, 3.0]), 3.0);
        assert_eq!(median(&mut [f64::INFINITY, 1.0, 2.0]), 2.0);
    }
}
