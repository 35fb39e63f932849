//! A processor that is but modelled: how long work takes on it, while other programs take it away.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::anytime::clock::Clock;
use crate::anytime::cost_model::{CostModel, Phase};
use crate::anytime::interrupt::Interrupt;

/// Length of a burst.
const BURST: Duration = Duration::from_millis(400);
/// From the beginning of one burst to the next: a third of the time is burst.
const BURST_PERIOD: Duration = Duration::from_millis(1200);

/// What slows the machine down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// All work takes so many times as long as the costs say.
    pub slowdown: f64,
    /// During bursts, 0.4 s in every 1.2 s, it takes so many times as long again; 1: there are none.
    pub bursts: f64,
}

impl Load {
    /// How much slower than without bursts the machine is at a time, and until when.
    fn burst_at(&self, time: Duration) -> (f64, Duration) {
        let (period, burst) = (BURST_PERIOD.as_nanos(), BURST.as_nanos());
        let phase = time.as_nanos() % period;
        // The first burst comes after the start, when the car drives.
        let (factor, left) = if phase >= period - burst { (self.bursts, period - phase) } else { (1.0, period - burst - phase) };
        (factor, time + Duration::from_nanos(u64::try_from(left).unwrap_or(u64::MAX)))
    }

    /// When work that takes `alone` without bursts, begun at `start`, is done.
    pub(super) fn done(&self, start: Duration, alone: Duration) -> Duration {
        let (mut now, mut left) = (start, alone.as_secs_f64());
        if self.bursts <= 1.0 {
            return start + alone;
        }
        loop {
            let (factor, until) = self.burst_at(now);
            let span = until.saturating_sub(now).as_secs_f64();
            if left * factor <= span {
                return now + Duration::from_secs_f64(left * factor);
            }
            left -= span / factor;
            now = until;
        }
    }
}

#[derive(Debug, Default)]
struct State {
    now: Duration,
    worked: Duration,
    is_quiet: bool,
}

/// The clock of such a processor: moves on by the work that is done on it, and stands still meanwhile.
#[derive(Debug)]
pub struct Processor {
    costs: CostModel,
    load: Load,
    state: Mutex<State>,
}

impl Processor {
    /// Whose work costs so much.
    pub fn new(costs: CostModel, load: Load) -> Self {
        Self { costs, load, state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// It is this time, and the work begins.
    pub fn set(&self, now: Duration) {
        self.state().now = now;
    }

    /// Whether there are no bursts for the present: before the drive.
    pub fn set_quiet(&self, is_quiet: bool) {
        self.state().is_quiet = is_quiet;
    }

    /// Processor time spent so far, other programs' apart.
    pub fn worked(&self) -> Duration {
        self.state().worked
    }
}

impl Clock for Processor {
    fn now(&self) -> Duration {
        self.state().now
    }

    fn worked(&self, phase: Phase, rays: usize) {
        if rays == 0 {
            return;
        }
        let alone = self.costs.typical(phase, rays).mul_f64(self.load.slowdown);
        let mut state = self.state();
        state.worked += alone;
        state.now = if state.is_quiet { state.now + alone } else { self.load.done(state.now, alone) };
    }
}

/// Calls for the answer once the processor's clock has come so far.
pub(super) struct At {
    pub(super) processor: Arc<Processor>,
    pub(super) time: Duration,
}

impl Interrupt for At {
    fn is_requested(&self) -> bool {
        self.processor.now() >= self.time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    #[test]
    fn work_takes_longer_while_others_take_the_processor() {
        let load = Load { slowdown: 2.0, bursts: 10.0 };
        assert_eq!(load.done(ms(0), ms(30)), ms(30));
        assert_eq!(load.done(ms(900), ms(3)), ms(930), "within a burst");
        assert_eq!(load.done(ms(790), ms(12)), ms(820), "half before, half in it");
        assert_eq!(load.done(ms(1190), ms(3)), ms(1202), "and out of it");
        assert_eq!(Load { slowdown: 2.0, bursts: 1.0 }.done(ms(900), ms(3)), ms(903));
    }
}
