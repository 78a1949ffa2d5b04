//! Real roots of small polynomials: where a radial map stops growing.
//!
//! A polynomial is a slice of coefficients, the constant first.

/// Returns the value of the polynomial at `x`.
pub(crate) fn evaluate(polynomial: &[f64], x: f64) -> f64 {
    polynomial.iter().rev().fold(0.0, |sum, &coefficient| sum * x + coefficient)
}

/// Returns the smallest root in (0, `upper`) at which the polynomial changes sign.
pub(crate) fn smallest_positive_root(polynomial: &[f64], upper: f64) -> Option<f64> {
    if stays_positive(polynomial, upper) {
        return None;
    }
    sign_changes(polynomial, upper).first().copied()
}

/// Tells, cheaply and on the safe side, whether the polynomial is positive on all of [0, `upper`]:
/// the bound takes each negative coefficient at its worst and each other one at nothing.
fn stays_positive(polynomial: &[f64], upper: f64) -> bool {
    let Some((&constant, rest)) = polynomial.split_first() else { return false };
    let mut power = 1.0;
    let mut least = constant;
    for &coefficient in rest {
        power *= upper;
        least += coefficient.min(0.0) * power;
    }
    least > 0.0
}

/// Returns all sign changes in (0, `upper`), ascending.
///
/// Between two neighbouring roots of its derivative a polynomial is monotonic and has at most one
/// root, so that bisection between them misses nothing.
fn sign_changes(polynomial: &[f64], upper: f64) -> Vec<f64> {
    if polynomial.len() < 2 {
        return Vec::new();
    }
    let derivative: Vec<f64> = polynomial.iter().enumerate().skip(1).map(|(i, &c)| i as f64 * c).collect();
    let mut knots = sign_changes(&derivative, upper);
    knots.push(upper);
    let mut changes = Vec::new();
    let mut left = 0.0;
    for right in knots {
        if (evaluate(polynomial, left) > 0.0) != (evaluate(polynomial, right) > 0.0) {
            changes.push(bisect(polynomial, left, right));
        }
        left = right;
    }
    changes
}

/// Returns the sign change between `left` and `right`, to the last bit.
fn bisect(polynomial: &[f64], mut left: f64, mut right: f64) -> f64 {
    let left_is_positive = evaluate(polynomial, left) > 0.0;
    loop {
        let middle = 0.5 * (left + right);
        if middle <= left || middle >= right {
            return right;
        }
        if (evaluate(polynomial, middle) > 0.0) == left_is_positive {
            left = middle;
        } else {
            right = middle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(polynomial: &[f64], upper: f64, expected: Option<f64>) {
        match (smallest_positive_root(polynomial, upper), expected) {
            // Simple roots of polynomials with coefficients near one are good to a few units in the last place.
            (Some(found), Some(expected)) => assert!((found - expected).abs() < 1e-14 * expected.max(1.0)),
            (found, expected) => assert_eq!(found, expected),
        }
    }

    #[test]
    fn finds_the_smallest_root() {
        check(&[], 10.0, None);
        check(&[1.0], 10.0, None);
        check(&[1.0, 0.5], 10.0, None);
        check(&[1.0, -0.5], 10.0, Some(2.0));
        check(&[1.0, -0.5], 1.9, None);
        check(&[6.0, -11.0, 6.0, -1.0], 10.0, Some(1.0));
        // Two roots, 1 and 1.0625, that a scan with step 0.1 would miss.
        check(&[1.0625, -2.0625, 1.0], 10.0, Some(1.0));
        // Dips towards zero at 1 without reaching it.
        check(&[1.01, -2.0, 1.0], 10.0, None);
        check(&[1.0, 0.0, 0.0, 0.0], 10.0, None);
    }
}
