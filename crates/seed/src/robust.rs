//! Medians and the Cauchy loss.

/// Returns the median of `values`, the upper one of an even number; zero of none.
pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return 0.0;
    }
    *sorted.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Returns the weight that the Cauchy loss of width `width` gives a residual: `1 / (1 + (r/width)²)`.
pub(crate) fn cauchy_weight(residual: f64, width: f64) -> f64 {
    let relative = residual / width;
    1.0 / (1.0 + relative * relative)
}

/// A sum of Cauchy losses `width² ln(1 + r²/width²)`, with few logarithms: of products, not of factors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossSum {
    inverse_width_square: f64,
    product: f64,
    logarithms: f64,
}

impl LossSum {
    /// Returns an empty sum for a loss of width `width`.
    pub fn new(width: f64) -> Self {
        Self { inverse_width_square: 1.0 / (width * width), product: 1.0, logarithms: 0.0 }
    }

    /// Adds the loss of a squared residual, and returns its weight `1 / (1 + r²/width²)`.
    #[inline(always)]
    pub fn add(&mut self, square: f64) -> f64 {
        let factor = 1.0 + square * self.inverse_width_square;
        self.product *= factor;
        // Far from overflow, whatever the next factor is.
        if self.product > 1e150 {
            self.logarithms += self.product.ln();
            self.product = 1.0;
        }
        1.0 / factor
    }

    /// Returns the sum.
    pub fn total(&self) -> f64 {
        (self.logarithms + self.product.ln()) / self.inverse_width_square
    }
}

/// Returns the loss width that suits residuals of which `median_norm` is the median length.
///
/// For normal noise of unit sigma on either axis the median length is 1.177; the width is 3 sigmas.
pub(crate) fn width_for(median_norm: f64) -> f64 {
    (3.0 / 1.177 * median_norm).max(1e-4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_half_the_slope_of_the_loss() {
        for residual in [0.1, 1.0, 5.0f64] {
            let (width, step) = (1.7, 1e-6);
            let loss = |r: f64| {
                let mut sum = LossSum::new(width);
                (sum.add(r * r), sum.total())
            };
            let slope = (loss(residual + step).1 - loss(residual - step).1) / (2.0 * step);
            let weight = cauchy_weight(residual, width);
            // The central difference is good to 1e-9.
            assert!((slope - 2.0 * residual * weight).abs() < 1e-7);
            assert!((loss(residual).0 - weight).abs() < 1e-12);
        }
    }

    #[test]
    fn long_sums_of_losses_do_not_overflow() {
        let mut sum = LossSum::new(0.5);
        for _ in 0..1000 {
            sum.add(100.0);
        }
        assert!((sum.total() / (250.0 * 401f64.ln()) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn medians_of_short_lists() {
        assert_eq!(median(&[]), 0.0);
        assert_eq!(median(&[3.0]), 3.0);
        assert_eq!(median(&[5.0, 1.0, 3.0]), 3.0);
    }
}
