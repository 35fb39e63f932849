//! Quantiles: values that were there, none in between.

use std::cmp::Ordering;

/// The least value that a `share` of the values do not exceed; `None` when there are none. Reorders them, in linear time.
pub fn quantile<T: Copy>(values: &mut [T], share: f64, compare: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    let index = index(values.len(), share)?;
    Some(*values.select_nth_unstable_by(index, compare).1)
}

/// The same of values that are sorted.
pub fn of_sorted<T: Copy>(sorted: &[T], share: f64) -> Option<T> {
    index(sorted.len(), share).map(|index| sorted[index])
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a share of a length
fn index(count: usize, share: f64) -> Option<usize> {
    let last = count.checked_sub(1)?;
    Some(((count as f64 * share).ceil() as usize).saturating_sub(1).min(last))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_values_that_were_there() {
        let of = |values: &[u32], share| quantile(&mut values.to_vec(), share, u32::cmp);
        assert_eq!([0.0, 0.5, 0.75, 0.8, 1.0].map(|share| of(&[4, 1, 3, 2], share)), [1, 2, 3, 4, 4].map(Some));
        assert_eq!((of(&[7], 0.5), of(&[], 0.5)), (Some(7), None));
    }

    #[test]
    fn percentiles_of_sorted_values_are_the_same() {
        let values: Vec<u32> = (1..=200).collect();
        assert_eq!([0.0, 0.5, 0.95, 0.99, 1.0].map(|share| of_sorted(&values, share)), [1, 100, 190, 198, 200].map(Some));
        for count in 1..300_usize {
            for percent in [50, 95, 99, 100] {
                let index = index(count, percent as f64 / 100.0);
                assert_eq!(index, Some((count * percent).div_ceil(100) - 1), "{count}, {percent}");
            }
        }
        assert_eq!((of_sorted(&[7], 0.01), of_sorted::<f64>(&[], 0.5)), (Some(7), None));
    }
}
