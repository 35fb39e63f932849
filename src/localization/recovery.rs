//! Whether a search is on the wrong track: scans fit worse than they would (after augmented MCL; Thrun et al., 2005).

/// Weight of the newest fit in the fast and in the slow average.
const RATES: (f64, f64) = (0.1, 0.002);
/// Scans that the averages begin with before they are compared.
const SETTLING: u32 = 20;

/// Averages of how well scans fit.
#[derive(Clone, Debug, Default)]
pub(super) struct Fit {
    fast: f64,
    slow: f64,
    /// What was expected beforehand, and as slowly given up where scans say otherwise.
    expected: f64,
    scans: u32,
}

impl Fit {
    /// For a robot that has been looked for all over the map: it may have been found in the wrong place, where nothing ever fits.
    /// What fits in the right one, the model says.
    pub(super) fn expecting(likelihood: f64) -> Self {
        Self { expected: likelihood, ..Self::default() }
    }

    /// Takes the likelihood of a scan, per beam.
    pub(super) fn add(&mut self, likelihood: f64) {
        self.scans = self.scans.saturating_add(1);
        // Plain means at first.
        let first = f64::from(self.scans).recip();
        self.fast += RATES.0.max(first) * (likelihood - self.fast);
        self.slow += RATES.1.max(first) * (likelihood - self.slow);
        self.expected += RATES.1 * (likelihood - self.expected);
    }

    /// Whether scans fit worse than `part` of what they use to.
    pub(super) fn is_lost(&self, part: f64) -> bool {
        self.scans >= SETTLING && self.fast < part * self.usual()
    }

    /// What scans use to fit, or are expected to.
    fn usual(&self) -> f64 {
        self.slow.max(self.expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fits_worse_than_usual_or_than_expected_is_lost() {
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
