//! Repairs stamps that are out of order.
//!
//! The lines of a log are in the right order, but their clock may have been set back or read late. The repaired stamps are the
//! ordered ones that are closest to those of the log by least squares, computed by the pool adjacent violators algorithm (Ayer et
//! al., 1955).

use crate::time::Stamp;

/// Minimum interval between repaired stamps, s, or half the mean interval if that is less.
const MIN_INTERVAL: f64 = 0.02;

/// A block of pooled stamps. The i-th stamp of the log is first shifted back by i times the minimum interval.
struct Block {
    /// Mean of the shifted stamps, s after the first stamp of the log.
    mean: f64,
    /// Number of stamps.
    count: usize,
}

/// How the stamps of a log were repaired.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StampRepair {
    /// Number of changed stamps.
    pub count: usize,
    /// Largest change, s.
    pub max_change: f64,
}

/// Makes the stamps of `items` strictly increasing, if they are not.
pub(super) fn repair_stamps<T>(items: &mut [T], stamp_of: impl Fn(&mut T) -> &mut Stamp) -> StampRepair {
    let stamps: Vec<Stamp> = items.iter_mut().map(|item| *stamp_of(item)).collect();
    let (Some(first), Some(last)) = (stamps.first(), stamps.last()) else { return StampRepair::default() };
    if stamps.is_sorted_by(|earlier, later| earlier < later) {
        return StampRepair::default();
    }
    let interval = MIN_INTERVAL.min(0.5 * last.seconds_since(*first).max(0.0) / stamps.len() as f64);
    let shift = |index: usize| index as f64 * interval;
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
    let mut repair = StampRepair::default();
    let means = blocks.iter().flat_map(|block| std::iter::repeat_n(block, block.count));
    for (index, (item, block)) in items.iter_mut().zip(means).enumerate() {
        // A stamp that was not pooled with others stays exactly as it was.
        if block.count > 1 {
            let stamp = stamp_of(item);
            let in_order = first.offset_by(block.mean + shift(index));
            repair =
                StampRepair { count: repair.count + 1, max_change: repair.max_change.max(in_order.seconds_since(*stamp).abs()) };
            *stamp = in_order;
        }
    }
    repair
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn repaired(seconds: &[f64]) -> Vec<f64> {
        let mut stamps: Vec<Stamp> = seconds.iter().map(|s| Stamp::from_seconds(1000.0 + s)).collect();
        repair_stamps(&mut stamps, |stamp| stamp);
        stamps.iter().map(|stamp| stamp.seconds_since(Stamp::from_seconds(1000.0))).collect()
    }

    #[test]
    fn ordered_stamps_are_unchanged_and_swapped_ones_are_averaged() {
        let fast = [0.0, 0.001, 0.002, 5.0];
        assert_eq!(repaired(&fast), fast);
        let expected = [0.0, 1.0, 1.99, 2.01, 4.0];
        assert!(repaired(&[0.0, 1.0, 2.1, 1.9, 4.0]).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8));
    }

    proptest! {
        #[test]
        fn repaired_stamps_always_increase_strictly(seconds in prop::collection::vec(-10.0..10.0, 2..50), end in 20.0..40.0) {
            let mut seconds = seconds;
            seconds.push(end);
            let repaired = repaired(&seconds);
            prop_assert!(repaired.is_sorted_by(|a, b| a < b), "{repaired:?}");
            // Least squares keeps the mean.
            let sum = |values: &[f64]| values.iter().sum::<f64>();
            prop_assert!((sum(&repaired) - sum(&seconds)).abs() < 1e-5);
        }
    }
}
