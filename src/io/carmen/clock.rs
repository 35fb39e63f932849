//! Repairs stamps that are out of order.
//!
//! Lines are written in the order in which things happened, but stamped by a clock that was set back, or read late. The stamps in
//! order that are nearest to those of the log, by least squares, come from pooling adjacent violators (Ayer et al., 1955).

use crate::time::Stamp;

/// Repaired stamps are at least this far apart, s, or half the mean spacing if that is less.
const SPACING: f64 = 0.02;

/// Stamps that count as one block: their mean, after every stamp was shifted so that spacing counts as none.
struct Block {
    /// s, after the first stamp.
    mean: f64,
    count: usize,
}

/// What was done to the stamps of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mended {
    /// How many were changed.
    pub count: usize,
    /// The largest change, s.
    pub most: f64,
}

/// Puts the stamps of `items` in order, if they are not.
pub(super) fn mend<T>(items: &mut [T], stamp_of: impl Fn(&mut T) -> &mut Stamp) -> Mended {
    let stamps: Vec<Stamp> = items.iter_mut().map(|item| *stamp_of(item)).collect();
    let (Some(first), Some(last)) = (stamps.first(), stamps.last()) else { return Mended::default() };
    if stamps.is_sorted_by(|earlier, later| earlier < later) {
        return Mended::default();
    }
    let spacing = SPACING.min(0.5 * last.seconds_since(*first).max(0.0) / stamps.len() as f64);
    let shift = |index: usize| index as f64 * spacing;
    let mut blocks: Vec<Block> = Vec::new();
    for (index, stamp) in stamps.iter().enumerate() {
        let mut block = Block { mean: stamp.seconds_since(*first) - shift(index), count: 1 };
        while let Some(before) = blocks.pop_if(|before| before.mean > block.mean) {
            let count = before.count + block.count;
            let sum = before.mean * before.count as f64 + block.mean * block.count as f64;
            block = Block { mean: sum / count as f64, count };
        }
        blocks.push(block);
    }
    let mut mended = Mended::default();
    let means = blocks.iter().flat_map(|block| std::iter::repeat_n(block, block.count));
    for (index, (item, block)) in items.iter_mut().zip(means).enumerate() {
        // Stamps on their own stay as they were, to the nanosecond.
        if block.count > 1 {
            let stamp = stamp_of(item);
            let in_order = first.offset_by(block.mean + shift(index));
            mended = Mended { count: mended.count + 1, most: mended.most.max(in_order.seconds_since(*stamp).abs()) };
            *stamp = in_order;
        }
    }
    mended
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mended(seconds: &[f64]) -> Vec<f64> {
        let mut stamps: Vec<Stamp> = seconds.iter().map(|s| Stamp::from_seconds(1000.0 + s)).collect();
        mend(&mut stamps, |stamp| stamp);
        stamps.iter().map(|stamp| stamp.seconds_since(Stamp::from_seconds(1000.0))).collect()
    }

    #[test]
    fn what_is_in_order_stays_and_what_is_not_meets_in_the_middle() {
        let fast = [0.0, 0.001, 0.002, 5.0];
        assert_eq!(mended(&fast), fast);
        let expected = [0.0, 1.0, 1.99, 2.01, 4.0];
        assert!(mended(&[0.0, 1.0, 2.1, 1.9, 4.0]).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8));
    }

    proptest! {
        #[test]
        fn the_order_is_strict_whatever_the_stamps(seconds in prop::collection::vec(-10.0..10.0, 2..50), end in 20.0..40.0) {
            let mut seconds = seconds;
            seconds.push(end);
            let mended = mended(&seconds);
            prop_assert!(mended.is_sorted_by(|a, b| a < b), "{mended:?}");
            // Least squares keeps the mean.
            let sum = |values: &[f64]| values.iter().sum::<f64>();
            prop_assert!((sum(&mended) - sum(&seconds)).abs() < 1e-5);
        }
    }
}
