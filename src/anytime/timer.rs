//! Something to be done again and again.

use std::time::Duration;

/// A steady rate. Whoever comes late does once what is due and leaves out the rest; timers whose periods divide each other stay
/// together.
#[derive(Clone, Debug)]
pub struct Timer {
    period: Duration,
    next: Duration,
}

impl Timer {
    /// Due every `period`, which is not zero, for the first time when the clock reads `first`.
    pub fn new(period: Duration, first: Duration) -> Self {
        Self { period, next: first }
    }

    /// Time until it is due next.
    pub fn left(&self, now: Duration) -> Duration {
        self.next.saturating_sub(now)
    }

    /// Whether it is due; if so, it is taken to be done.
    pub fn is_due(&mut self, now: Duration) -> bool {
        let Some(late) = now.checked_sub(self.next) else { return false };
        let missed = late.div_duration_f64(self.period).floor();
        self.next += self.period.mul_f64(missed + 1.0);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_its_rate_and_leaves_out_what_was_missed() {
        let at = Duration::from_millis;
        let mut timer = Timer::new(at(10), at(5));
        assert_eq!((timer.left(at(1)), timer.left(at(7))), (at(4), at(0)));
        let due: Vec<u64> = (0..60).filter(|&now| timer.is_due(at(now))).collect();
        assert_eq!(due, [5, 15, 25, 35, 45, 55]);
        assert!(timer.is_due(at(508)) && !timer.is_due(at(514)) && timer.is_due(at(515)), "on the beat again");
    }
}
