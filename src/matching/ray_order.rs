//! The order in which rays are used, from coarse to fine: every prefix of it is spread over the whole field of view.
//!
//! The position of ray `i` in the order is `i` with its bits reversed (van der Corput sequence). The first 2^k rays are evenly
//! spaced, and a longer prefix contains every shorter one.

/// A prefix of the order.
#[derive(Clone, Copy, Debug)]
pub(super) struct RayOrder {
    shift: u32,
    limit: u64,
    /// All rays in the prefix are multiples of this, a power of two.
    stride: usize,
    total: usize,
}

impl RayOrder {
    /// About the first `count` of `total` rays: exactly that many if `count` is a power of two or at least `total`.
    pub(super) fn first(count: usize, total: usize) -> Self {
        let slots = total.max(2).next_power_of_two();
        let limit = if count >= total { slots as u64 } else { (count as u64 * slots as u64).div_ceil(total as u64) };
        let stride = slots / usize::try_from(limit.next_power_of_two()).unwrap_or(slots).min(slots);
        Self { shift: u64::BITS - slots.trailing_zeros(), limit, stride, total }
    }

    /// Whether the prefix is the whole order.
    pub(super) fn is_all(self) -> bool {
        self.stride == 1 && self.limit.is_power_of_two()
    }

    /// Indices of the rays in the prefix, ascending.
    #[inline]
    pub(super) fn rays(self) -> impl Iterator<Item = usize> {
        let is_even = self.limit.is_power_of_two();
        let contains = move |i: &usize| is_even || (*i as u64).reverse_bits() >> self.shift < self.limit;
        (0..self.total).step_by(self.stride).filter(contains)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(count: usize, total: usize) -> Vec<usize> {
        RayOrder::first(count, total).rays().collect()
    }

    #[test]
    fn every_prefix_covers_the_whole_sweep_and_contains_the_shorter_ones() {
        for total in [10, 181, 361, 1024, 1081, 10_000] {
            let mut shorter: Vec<usize> = Vec::new();
            for count in [1, 4, 10, 64, 100, 512, 1000, total] {
                let longer = chosen(count.min(total), total);
                assert!(shorter.iter().all(|i| longer.contains(i)), "{count} of {total}");
                let expected = count.min(total);
                assert!(longer.len().abs_diff(expected) <= 1 + expected / 8, "{} for {count} of {total}", longer.len());
                // No gap is longer than that of half as many rays.
                let widest = longer.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(total);
                assert!(widest <= (4 * total).div_ceil(expected).max(1), "{widest} between {count} of {total}");
                shorter = longer;
            }
            assert_eq!(shorter, (0..total).collect::<Vec<_>>());
        }
    }
}
