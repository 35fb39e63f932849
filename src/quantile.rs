//! Quantiles without interpolation: each is one of the values.

use std::cmp::Ordering;

/// The smallest value such that at least a `fraction` of the values do not exceed it; `None` if there are no values. Reorders the
/// values, in linear time.
pub fn quantile<T: Copy>(values: &mut [T], fraction: f64, compare: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    let index = index(values.len(), fraction)?;
    Some(*values.select_nth_unstable_by(index, compare).1)
}

/// The same quantile of sorted values.
pub fn of_sorted<T: Copy>(sorted: &[T], fraction: f64) -> Option<T> {
    index(sorted.len(), fraction).map(|index| sorted[index])
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a fraction of a length
fn index(count: usize, fraction: f64) -> Option<usize> {
    let last = count.checked_sub(1)?;
    Some(((count as f64 * fraction).ceil() as usize).saturating_sub(1).min(last))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_among_the_values() {
        let of = |values: &[u32], fraction| quantile(&mut values.to_vec(), fraction, u32::cmp);
        assert_eq!([0.0, 0.5, 0.75, 0.8, 1.0].map(|fraction| of(&[4, 1, 3, 2], fraction)), [1, 2, 3, 4, 4].map(Some));
        assert_eq!((of(&[7], 0.5), of(&[], 0.5)), (Some(7), None));
    }

    #[test]
    fn quantiles_of_sorted_values_are_the_same() {
        let values: Vec<u32> = (1..=200).collect();
        assert_eq!([0.0, 0.5, 0.95, 0.99, 1.0].map(|fraction| of_sorted(&values, fraction)), [1, 100, 190, 198, 200].map(Some));
        for count in 1..300_usize {
            for percent in [50, 95, 99, 100] {
                let index = index(count, percent as f64 / 100.0);
                assert_eq!(index, Some((count * percent).div_ceil(100) - 1), "{count}, {percent}");
            }
        }
        assert_eq!((of_sorted(&[7], 0.01), of_sorted::<f64>(&[], 0.5)), (Some(7), None));
    }
}
