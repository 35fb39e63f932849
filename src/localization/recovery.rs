//! Whether the filter has lost its robot: scans fit worse than they use to (after augmented MCL; Thrun et al., 2005).

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
    /// Whether `slow` was known beforehand.
    is_given: bool,
}

impl Fit {
    /// For a robot that has been looked for all over the map: it may have been found in the wrong place, where nothing ever fits.
    /// What fits in the right one, the model says.
    pub(super) fn expecting(likelihood: f64) -> Self {
        Self { slow: likelihood, is_given: true, ..Self::default() }
    }

    /// Takes the likelihood of a scan, per beam.
    pub(super) fn add(&mut self, likelihood: f64) {
        self.scans = self.scans.saturating_add(1);
        // Plain means at first.
        let first = f64::from(self.scans).recip();
        self.fast += RATES.0.max(first) * (likelihood - self.fast);
        self.slow += if self.is_given { RATES.1 } else { RATES.1.max(first) } * (likelihood - self.slow);
    }

    /// Whether scans fit worse than `part` of what they use to.
    pub(super) fn is_lost(&self, part: f64) -> bool {
        self.scans >= SETTLING && self.fast < part * self.slow
    }

    /// What scans use to fit.
    pub(super) fn usual(&self) -> f64 {
        self.slow
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
        assert!(after(Fit::expecting(0.03), &bad) && !after(Fit::expecting(0.03), &good));
    }
}
