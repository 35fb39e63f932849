//! A periodic timer.

use std::time::Duration;

/// A timer with a fixed rate. Missed periods are skipped; timers whose periods divide each other stay in phase.
#[derive(Clone, Debug)]
pub struct Timer {
    period: Duration,
    next: Duration,
}

impl Timer {
    /// A timer that fires every `period`, which must not be zero, for the first time when the clock reads `first`.
    pub fn new(period: Duration, first: Duration) -> Self {
        Self { period, next: first }
    }

    /// Time until it is due.
    pub fn left(&self, now: Duration) -> Duration {
        self.next.saturating_sub(now)
    }

    /// Whether it is due; if so, it advances to the next period.
    pub fn is_due(&mut self, now: Duration) -> bool {
        let Some(delay) = now.checked_sub(self.next) else { return false };
        let missed = delay.div_duration_f64(self.period).floor();
        self.next += self.period.mul_f64(missed + 1.0);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_its_rate_and_skips_missed_periods() {
        let at = Duration::from_millis;
        let mut timer = Timer::new(at(10), at(5));
        assert_eq!((timer.left(at(1)), timer.left(at(7))), (at(4), at(0)));
        let due: Vec<u64> = (0..60).filter(|&now| timer.is_due(at(now))).collect();
        assert_eq!(due, [5, 15, 25, 35, 45, 55]);
        assert!(timer.is_due(at(508)) && !timer.is_due(at(514)) && timer.is_due(at(515)), "back in phase");
    }
}
