//! How much ranges err: as much as is assumed, or more, where the lines that were fitted to scans show it.
//!
//! Ranges that err more than is assumed, and neighbours alike, give lines directions that the wall does not have. In a corridor that is
//! taken for knowledge of how far one has come along it.

/// Views that the noise is known from, about; it may change.
const MEMORY: f64 = 20.0;

/// The noise of ranges.
#[derive(Clone, Copy, Debug)]
pub(super) struct RangeNoise {
    /// Least standard deviation, m.
    assumed: f64,
    /// Mean variance shown by the views, m^2.
    shown: f64,
    /// Views that have shown it.
    views: f64,
}

impl RangeNoise {
    /// `assumed`: standard deviation, m.
    pub(super) fn new(assumed: f64) -> Self {
        Self { assumed, shown: 0.0, views: 0.0 }
    }

    /// Standard deviation, m.
    pub(super) fn deviation(&self) -> f64 {
        self.shown.sqrt().max(self.assumed)
    }

    /// Takes note of the variance that a view shows, m^2.
    pub(super) fn observe(&mut self, variance: f64) {
        self.views = (self.views + 1.0).min(MEMORY);
        self.shown += (variance - self.shown) / self.views;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_views_show_counts_where_it_is_more() {
        let mut noise = RangeNoise::new(0.01);
        assert!((noise.deviation() - 0.01).abs() < 1e-12);
        (0..3).for_each(|_| noise.observe(0.02_f64.powi(2)));
        assert!((noise.deviation() - 0.02).abs() < 1e-12);
        (0..200).for_each(|_| noise.observe(0.005_f64.powi(2)));
        assert!((noise.deviation() - 0.01).abs() < 1e-12, "what was shown long ago is forgotten");
    }
}
