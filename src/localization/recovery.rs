//! Whether the filter has lost its robot: scans fit worse than they use to (augmented MCL; Thrun et al., 2005).

/// Weight of the newest fit in the fast and in the slow average.
const RATES: (f64, f64) = (0.1, 0.002);
/// Scans that the averages begin with before they are compared.
const SETTLING: u32 = 20;

/// Averages of how well scans fit.
#[derive(Clone, Debug, Default)]
pub(super) struct Fit {
    fast: f64,
    slow: f64,
    scans: u32,
}

impl Fit {
    /// Takes the likelihood of a scan, per beam.
    pub(super) fn add(&mut self, likelihood: f64) {
        self.scans = self.scans.saturating_add(1);
        // Plain means at first.
        let by = |rate: f64| rate.max(f64::from(self.scans).recip());
        self.fast += by(RATES.0) * (likelihood - self.fast);
        self.slow += by(RATES.1) * (likelihood - self.slow);
    }

    /// The part of the particles to throw over the whole map, when the fast average is below a part of the slow one.
    pub(super) fn random_part(&self, threshold: f64) -> f64 {
        if self.scans < SETTLING || self.slow <= 0.0 || threshold <= 0.0 {
            return 0.0;
        }
        (1.0 - self.fast / (threshold * self.slow)).max(0.0)
    }
}
