//! How much of what a robot sees the map explains, where it is believed to be.
//!
//! A likelihood falls with the noise of the laser, the size of cells and grazing rays, at the right pose as well. The part of the beams that
//! end about where the map has a wall does not: at the right pose it is nearly all that nobody stands in front of, at a wrong one, or on
//! the map of another place, some two fifths. It is averaged fast and slowly, as in augmented MCL (Thrun, Burgard and Fox, 2005, 8.3.3).

use super::observation::Observation;
use super::sensor::SensorKnobs;

/// A pose that explains less than this part of the beams is not known to be right: more of them contradict the map than agree with it.
pub(crate) const LEAST: f64 = 0.5;
/// A place that was looked for is believed if it explains this part of the beams: as many as are left when a quarter of what a map
/// explains is hidden, and more than the wrong place.
pub(super) const FOUND: f64 = 0.6;
/// One pose explains the scans decidedly better than another with this part of the beams more: twice what chance gives in a second of scans.
pub(super) const DECIDED: f64 = 0.1;
/// Standard deviations of a range within which the map explains it.
const TOLERANCE: f64 = 3.0;
/// Times over which the averages reach, s.
const REACH: (f64, f64) = (1.0, 30.0);

/// The part of what a scan shows that the `expected` ranges, m, explain.
pub(super) fn explained(sensor: &SensorKnobs, seen: &Observation, expected: impl IntoIterator<Item = f64>) -> f64 {
    let (tolerance, reach) = (TOLERANCE * sensor.hit_error, sensor.max_range.min(seen.reach));
    let is_explained = |(measured, expected): (&f64, f64)| (measured.min(reach) - expected.min(reach)).abs() <= tolerance;
    let explained = seen.ranges.iter().zip(expected).filter(|&pair| is_explained(pair)).count();
    explained as f64 / seen.len().max(1) as f64
}

/// Averages of the part of the beams that a pose explains.
#[derive(Clone, Debug)]
pub(super) struct Agreement {
    fast: f64,
    slow: f64,
    /// Time that the averages are of, s.
    seconds: f64,
}

impl Agreement {
    /// Nothing has been seen; `expected` of the beams should be explained.
    pub(super) fn expecting(expected: f64) -> Self {
        Self { fast: expected, slow: expected, seconds: 0.0 }
    }

    /// With a scan, `seconds` after the one before, of whose beams this part is explained.
    #[must_use]
    pub(super) fn with(&self, explained: f64, seconds: f64) -> Self {
        // The fast one is a plain mean at first, the slow one begins with what was expected.
        let passed = self.seconds + seconds;
        let rate = |reach: f64| 1.0 - (-seconds / reach).exp();
        let fast = rate(REACH.0).max(seconds / passed.max(1e-9));
        Self {
            fast: self.fast + fast * (explained - self.fast),
            slow: self.slow + rate(REACH.1) * (explained - self.slow),
            seconds: passed,
        }
    }

    /// Of the last second.
    pub(super) fn recent(&self) -> f64 {
        self.fast
    }

    /// Whether the pose may be wrong: scans are explained worse than `part` of what they use to, or of what can be believed.
    pub(super) fn is_doubtful(&self, part: f64) -> bool {
        part > 0.0 && self.seconds >= REACH.0 && self.fast < (part * self.slow).max(LEAST)
    }

    /// Whether that is over, by more than chance.
    pub(super) fn is_good(&self, part: f64) -> bool {
        self.fast >= (0.5 * (1.0 + part) * self.slow).max(FOUND)
    }

    /// Nothing explains the scans better: that is how well the map does here.
    pub(super) fn settle(&mut self) {
        self.slow = self.fast;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 scans in each second.
    fn after(parts: &[(f64, f64)]) -> Agreement {
        let scans = parts.iter().flat_map(|&(seconds, part)| std::iter::repeat_n(part, (seconds * 40.0) as usize));
        scans.fold(Agreement::expecting(0.8), |agreement, part| agreement.with(part, 0.025))
    }

    #[test]
    fn noise_is_no_doubt_and_another_place_is() {
        for fine in [after(&[(60.0, 0.98)]), after(&[(60.0, 0.98), (0.5, 0.7)]), after(&[(60.0, 0.8), (2.0, 0.7)])] {
            assert!(!fine.is_doubtful(0.85), "{fine:?}");
        }
        for elsewhere in [after(&[(60.0, 0.98), (2.0, 0.6)]), after(&[(2.0, 0.4)]), after(&[(200.0, 0.4)])] {
            assert!(elsewhere.is_doubtful(0.85) && !elsewhere.is_doubtful(0.0), "{elsewhere:?}");
        }
        assert!(!after(&[(0.5, 0.1)]).is_doubtful(0.85), "half a second says little");
        assert!(after(&[(60.0, 0.98), (2.0, 0.6), (4.0, 0.95)]).is_good(0.85));
    }

    #[test]
    fn ranges_off_by_the_noise_are_explained_and_nothing_seen_is_too() {
        let sensor = SensorKnobs { hit_error: 0.1, max_range: 10.0, ..SensorKnobs::default() };
        let mut seen = Observation::of(vec![0.0; 5], vec![2.0, 2.2, 2.4, f64::INFINITY, f64::INFINITY]);
        let part = |seen: &Observation| explained(&sensor, seen, [2.0, 2.0, 2.0, f64::INFINITY, 5.0]);
        assert!((part(&seen) - 0.6).abs() < 1e-9, "{}", part(&seen));
        seen.reach = 4.0;
        assert!((part(&seen) - 0.8).abs() < 1e-9, "{}", part(&seen));
    }
}
