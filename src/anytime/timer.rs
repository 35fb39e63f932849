//! When the next update is due.

use std::time::Duration;

/// A timer; without a period it is always time.
#[derive(Clone, Debug)]
pub struct Timer {
    period: Option<Duration>,
    next: Duration,
}

impl Timer {
    /// `period`, s; 0: none. The first update is due one period after `now`.
    pub fn new(period: f64, now: Duration) -> Self {
        let period = Duration::try_from_secs_f64(period).ok().filter(|period| !period.is_zero());
        Self { period, next: now + period.unwrap_or_default() }
    }

    /// Whether it ever calls.
    pub fn has_period(&self) -> bool {
        self.period.is_some()
    }

    /// Time until the next update is due; `None`: messages alone drive the updates.
    pub fn left(&self, now: Duration) -> Option<Duration> {
        self.period.map(|_| self.next.saturating_sub(now))
    }

    /// Whether an update is due, that is, whether the time for it has come since it last was. Times that were missed are left out.
    pub fn is_due(&mut self, now: Duration) -> bool {
        let Some(period) = self.period else { return true };
        if now < self.next {
            return false;
        }
        self.next += period;
        if self.next <= now {
            self.next = now + period;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_are_due_once_a_period_and_missed_ones_are_left_out() {
        let at = Duration::from_millis;
        let mut timer = Timer::new(0.01, at(0));
        assert_eq!((timer.left(at(4)), timer.is_due(at(4))), (Some(at(6)), false));
        assert!(timer.is_due(at(11)) && !timer.is_due(at(12)) && timer.is_due(at(20)));
        assert!(timer.is_due(at(75)) && !timer.is_due(at(84)) && timer.is_due(at(85)));
        let mut none = Timer::new(0.0, at(0));
        assert!(none.left(at(5)).is_none() && none.is_due(at(5)) && none.is_due(at(5)));
    }
}
