//! Quantiles of values in no order, in linear time.

use std::cmp::Ordering;

/// The least value that a `share` of the values do not exceed; `None` when there are none. Reorders them.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a share of a length
pub fn quantile<T: Copy>(values: &mut [T], share: f64, compare: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    let last = values.len().checked_sub(1)?;
    let index = ((values.len() as f64 * share).ceil() as usize).saturating_sub(1).min(last);
    Some(*values.select_nth_unstable_by(index, compare).1)
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
}
