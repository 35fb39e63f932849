//! Something to be done again and again.

use std::time::Duration;

/// A steady rate. Whoever comes late does once what is due and leaves out the rest; beats of rates that divide each other stay
/// together.
pub(super) struct Beat {
    period: Duration,
    next: Duration,
}

impl Beat {
    /// So many times a second, at first when the clock reads `first`.
    pub(super) fn new(rate: f64, first: Duration) -> Self {
        Self { period: Duration::from_secs_f64(rate.recip()), next: first }
    }

    /// When it is due next.
    pub(super) fn next(&self) -> Duration {
        self.next
    }

    /// Whether it is due; if so, it is taken to be done.
    pub(super) fn is_due(&mut self, now: Duration) -> bool {
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
        let mut beat = Beat::new(100.0, at(5));
        let due: Vec<u64> = (0..60).filter(|&now| beat.is_due(at(now))).collect();
        assert_eq!(due, [5, 15, 25, 35, 45, 55]);
        assert!(beat.is_due(at(508)) && !beat.is_due(at(514)) && beat.is_due(at(515)), "on the beat again");
    }
}
