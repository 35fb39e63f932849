//! Range noise: the assumed standard deviation, or a larger one if the lines fitted to the scans show it.
//!
//! If ranges have more noise than assumed, and neighbouring rays share it, fitted lines get directions that the wall does not
//! have. In a corridor, this would be taken for information about the position along it.

/// Approximate number of views that the noise is averaged over, limited because the noise may change.
const MEMORY: f64 = 20.0;

/// Estimate of the range noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct RangeNoise {
    /// Minimum standard deviation, m.
    assumed: f64,
    /// Mean variance observed in the views, m^2.
    observed: f64,
    /// Number of views averaged, at most [`MEMORY`].
    views: f64,
}

impl RangeNoise {
    /// `assumed`: minimum standard deviation, m.
    pub(super) fn new(assumed: f64) -> Self {
        Self { assumed, observed: 0.0, views: 0.0 }
    }

    /// Standard deviation of a range, m.
    pub(super) fn standard_deviation(&self) -> f64 {
        self.observed.sqrt().max(self.assumed)
    }

    /// Adds the variance observed in a view, m^2.
    pub(super) fn observe(&mut self, variance: f64) {
        self.views = (self.views + 1.0).min(MEMORY);
        self.observed += (variance - self.observed) / self.views;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observed_noise_counts_if_it_exceeds_the_assumed_one() {
        let mut noise = RangeNoise::new(0.01);
        assert!((noise.standard_deviation() - 0.01).abs() < 1e-12);
        (0..3).for_each(|_| noise.observe(0.02_f64.powi(2)));
        assert!((noise.standard_deviation() - 0.02).abs() < 1e-12);
        (0..200).for_each(|_| noise.observe(0.005_f64.powi(2)));
        assert!((noise.standard_deviation() - 0.01).abs() < 1e-12, "old observations are forgotten");
    }
}
