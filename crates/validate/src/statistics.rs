//! Order statistics.

/// Returns the median, or `None` of nothing: the mean of the two middle values for an even number.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    let upper = *sorted.get(middle)?;
    Some(if sorted.len() % 2 == 1 { upper } else { 0.5 * (sorted[middle - 1] + upper) })
}

/// Returns the smallest value that at least `share` of the values do not exceed, or `None` of nothing.
pub(crate) fn quantile(values: impl IntoIterator<Item = f64>, share: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_quantiles() {
        assert_eq!((median([]), quantile([], 0.5)), (None, None));
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 2.0, 3.0]), Some(2.5));
        let hundred = || (1..=100).map(f64::from);
        assert_eq!(quantile(hundred(), 0.95), Some(95.0));
        assert_eq!((quantile(hundred(), 0.0), quantile(hundred(), 1.0)), (Some(1.0), Some(100.0)));
    }
}
