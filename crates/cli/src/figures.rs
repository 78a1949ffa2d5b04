//! Numbers as people read them: no more digits than are known.

/// Returns a value with its sigma: two digits of the sigma, and the value to the same place.
pub(crate) fn with_sigma(value: f64, sigma: Option<f64>) -> String {
    match sigma.filter(|sigma| sigma.is_finite() && *sigma > 0.0) {
        Some(sigma) => {
            let places = places(sigma);
            format!("{value:.places$} ± {sigma:.places$}")
        }
        None => significant(value),
    }
}

/// Returns the number of places that show two digits of a sigma.
fn places(sigma: f64) -> usize {
    // 9.96 shows as 10.0, which has its two digits one place earlier.
    let leading = (sigma * (1.0 + 5e-3)).log10().floor();
    (1.0 - leading).clamp(0.0, 9.0) as usize
}

/// Returns a value to the places that its sigma warrants, without the sigma.
pub(crate) fn to_sigma(value: f64, sigma: Option<f64>) -> String {
    match sigma.filter(|sigma| sigma.is_finite() && *sigma > 0.0) {
        Some(sigma) => format!("{value:.*}", places(sigma)),
        None => significant(value),
    }
}

/// Returns a value to six digits.
pub(crate) fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let leading = value.abs().log10().floor();
    if leading < -4.0 {
        return format!("{value:.3e}");
    }
    format!("{value:.*}", (5.0 - leading).clamp(0.0, 9.0) as usize)
}

/// Returns a count with its noun, such as `1 view` and `3 views`.
pub(crate) fn count(n: usize, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_follow_the_sigma() {
        for (value, sigma, expected) in [
            (533.0912, 0.4123, "533.09 ± 0.41"),
            (-0.28371, 0.0031, "-0.2837 ± 0.0031"),
            (1234.5, 12.3, "1234 ± 12"),
            (1234.5, 9.99, "1234 ± 10"),
            (1.0, 0.00999, "1.000 ± 0.010"),
        ] {
            assert_eq!(with_sigma(value, Some(sigma)), expected);
        }
        assert_eq!(with_sigma(533.0912, None), "533.091");
        assert_eq!(with_sigma(533.0912, Some(f64::NAN)), "533.091");
        assert_eq!(to_sigma(342.26, Some(0.81)), "342.26");
        assert_eq!(significant(-0.00012345678), "-0.000123457");
        assert_eq!(significant(1.5e-7), "1.500e-7");
        assert_eq!(count(1, "view"), "1 view");
    }
}
