//! Detects a global search with only wrong hypotheses: scans fit worse than expected (after augmented MCL; Thrun et al., 2005).

/// Weights of the newest fit in the fast and in the slow average.
const RATES: (f64, f64) = (0.1, 0.002);
/// Minimum number of scans before the averages are compared.
const MIN_SCANS: u32 = 20;

/// Averages of how well scans fit.
#[derive(Clone, Debug, Default)]
pub(super) struct Fit {
    fast: f64,
    slow: f64,
    /// Expected fit; it decays towards the measured fits as slowly as the slow average.
    expected: f64,
    scans: u32,
}

impl Fit {
    /// Starts with the fit that the model expects at the right pose. Without it, a search that starts with only wrong hypotheses,
    /// where nothing ever fits, would not be detected.
    pub(super) fn expecting(likelihood: f64) -> Self {
        Self { expected: likelihood, ..Self::default() }
    }

    /// Adds the likelihood per beam of a scan.
    pub(super) fn add(&mut self, likelihood: f64) {
        self.scans = self.scans.saturating_add(1);
        // Plain means at first.
        let first = f64::from(self.scans).recip();
        self.fast += RATES.0.max(first) * (likelihood - self.fast);
        self.slow += RATES.1.max(first) * (likelihood - self.slow);
        self.expected += RATES.1 * (likelihood - self.expected);
    }

    /// Whether scans fit worse than `ratio` times the typical fit.
    pub(super) fn is_lost(&self, ratio: f64) -> bool {
        self.scans >= MIN_SCANS && self.fast < ratio * self.typical()
    }

    /// The typical fit of scans, or the expected one if it is higher.
    fn typical(&self) -> f64 {
        self.slow.max(self.expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_worse_than_typical_or_expected_means_lost() {
        let after = |mut fit: Fit, likelihoods: &[f64]| {
            for &likelihood in likelihoods {
                fit.add(likelihood);
            }
            fit.is_lost(0.7)
        };
        let (good, bad) = ([0.1; 50], [0.01; 50]);
        assert!(!after(Fit::default(), &good) && !after(Fit::default(), &bad));
        assert!(after(Fit::default(), &[good, bad].concat()));
        assert!(after(Fit::expecting(0.03), &[good, bad].concat()));
        assert!(after(Fit::expecting(0.03), &bad) && !after(Fit::expecting(0.03), &good));
    }
}
