//! How much of a scan the map explains at the estimated pose.
//!
//! Laser noise, the cell size and grazing rays lower a likelihood even at the right pose. The fraction of the beams that end near
//! a wall of the map does not suffer from them: at the right pose it is nearly all beams that are not occluded, at a wrong pose
//! or on another map about two fifths. Its fast and slow averages are compared, as in augmented MCL (Thrun, Burgard and Fox,
//! 2005, 8.3.3).

use super::observation::Observation;
use super::sensor::SensorKnobs;

/// Minimum fraction of the beams that a pose must explain. Below it, more beams contradict the map than agree with it, so the
/// pose may be wrong.
pub(crate) const MIN_EXPLAINED: f64 = 0.5;
/// Minimum fraction of the beams that a pose found by the global search must explain: what remains when a quarter of the
/// explained beams are occluded, and more than a wrong pose explains.
pub(super) const MIN_EXPLAINED_BY_CANDIDATE: f64 = 0.6;
/// Minimum advantage in the explained fraction for one pose to replace another: twice the random variation over one second of
/// scans.
pub(super) const MIN_ADVANTAGE: f64 = 0.1;
/// Maximum range error of an explained beam, in standard deviations of a range.
const TOLERANCE_SIGMAS: f64 = 3.0;
/// Time constants of the fast and the slow average, s.
const TIME_CONSTANTS: (f64, f64) = (1.0, 30.0);

/// Computes the fraction of the beams that the `expected` ranges, m, explain.
pub(super) fn explained(sensor: &SensorKnobs, observation: &Observation, expected: impl IntoIterator<Item = f64>) -> f64 {
    let (tolerance, max_range) = (TOLERANCE_SIGMAS * sensor.hit_error, sensor.max_range.min(observation.max_range));
    let is_explained = |(measured, expected): (&f64, f64)| (measured.min(max_range) - expected.min(max_range)).abs() <= tolerance;
    let explained = observation.ranges.iter().zip(expected).filter(|&pair| is_explained(pair)).count();
    explained as f64 / observation.len().max(1) as f64
}

/// Fast and slow average of the fraction of the beams that a pose explains.
#[derive(Clone, Debug)]
pub(super) struct Agreement {
    fast: f64,
    slow: f64,
    /// Time covered by the averages, s.
    seconds: f64,
}

impl Agreement {
    /// Starts without scans, expecting this fraction of the beams to be explained.
    pub(super) fn expecting(expected: f64) -> Self {
        Self { fast: expected, slow: expected, seconds: 0.0 }
    }

    /// Adds a scan taken `seconds` after the previous one, with this fraction of its beams explained.
    #[must_use]
    pub(super) fn with(&self, explained: f64, seconds: f64) -> Self {
        // The fast average is a plain mean at first; the slow one starts from the expected value.
        let elapsed = self.seconds + seconds;
        let rate = |time_constant: f64| 1.0 - (-seconds / time_constant).exp();
        let fast = rate(TIME_CONSTANTS.0).max(seconds / elapsed.max(1e-9));
        Self {
            fast: self.fast + fast * (explained - self.fast),
            slow: self.slow + rate(TIME_CONSTANTS.1) * (explained - self.slow),
            seconds: elapsed,
        }
    }

    /// The average over about the last second.
    pub(super) fn recent(&self) -> f64 {
        self.fast
    }

    /// Whether the pose may be wrong: it explains less than `fraction` of the long-term average, or less than [`MIN_EXPLAINED`].
    pub(super) fn is_poor(&self, fraction: f64) -> bool {
        fraction > 0.0 && self.seconds >= TIME_CONSTANTS.0 && self.fast < (fraction * self.slow).max(MIN_EXPLAINED)
    }

    /// Whether the pose has become good again, with some hysteresis against random variation.
    pub(super) fn is_good(&self, fraction: f64) -> bool {
        self.fast >= (0.5 * (1.0 + fraction) * self.slow).max(MIN_EXPLAINED_BY_CANDIDATE)
    }

    /// Accepts the current level as normal: no other pose explains the scans better.
    pub(super) fn accept_current_level(&mut self) {
        self.slow = self.fast;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The agreement after these periods (duration in s, explained fraction) with 40 scans per second.
    fn after(periods: &[(f64, f64)]) -> Agreement {
        let scans = periods.iter().flat_map(|&(seconds, explained)| std::iter::repeat_n(explained, (seconds * 40.0) as usize));
        scans.fold(Agreement::expecting(0.8), |agreement, explained| agreement.with(explained, 0.025))
    }

    #[test]
    fn agreement_is_poor_at_a_wrong_pose_but_not_under_noise() {
        for fine in [after(&[(60.0, 0.98)]), after(&[(60.0, 0.98), (0.5, 0.7)]), after(&[(60.0, 0.8), (2.0, 0.7)])] {
            assert!(!fine.is_poor(0.85), "{fine:?}");
        }
        for elsewhere in [after(&[(60.0, 0.98), (2.0, 0.6)]), after(&[(2.0, 0.4)]), after(&[(200.0, 0.4)])] {
            assert!(elsewhere.is_poor(0.85) && !elsewhere.is_poor(0.0), "{elsewhere:?}");
        }
        assert!(!after(&[(0.5, 0.1)]).is_poor(0.85), "half a second is too short to judge");
        assert!(after(&[(60.0, 0.98), (2.0, 0.6), (4.0, 0.95)]).is_good(0.85));
    }

    #[test]
    fn ranges_within_the_noise_and_beams_out_of_range_are_explained() {
        let sensor = SensorKnobs { hit_error: 0.1, max_range: 10.0, ..SensorKnobs::default() };
        let mut observation = Observation::of(vec![0.0; 5], vec![2.0, 2.2, 2.4, f64::INFINITY, f64::INFINITY]);
        let fraction = |observation: &Observation| explained(&sensor, observation, [2.0, 2.0, 2.0, f64::INFINITY, 5.0]);
        assert!((fraction(&observation) - 0.6).abs() < 1e-9, "{}", fraction(&observation));
        observation.max_range = 4.0;
        assert!((fraction(&observation) - 0.8).abs() < 1e-9, "{}", fraction(&observation));
    }
}
