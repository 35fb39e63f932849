//! A simulated processor: how long work takes on it while other programs load it.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use crate::anytime::clock::Clock;
use crate::anytime::cost_model::{CostModel, Phase};
use crate::anytime::interrupt::Interrupt;
use crate::parallel::lock;

/// Duration of a load burst.
const BURST: Duration = Duration::from_millis(400);
/// Period of the bursts: a third of the time is burst.
const BURST_PERIOD: Duration = Duration::from_millis(1200);

/// The load of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Factor by which all work takes longer than its costs.
    pub slowdown: f64,
    /// Additional factor during bursts, which last 0.4 s of every 1.2 s; 1: no bursts.
    pub bursts: f64,
}

impl Load {
    /// The burst factor at a time, and until when it applies.
    fn burst_at(&self, time: Duration) -> (f64, Duration) {
        let (period, burst) = (BURST_PERIOD.as_nanos(), BURST.as_nanos());
        let phase = time.as_nanos() % period;
        // The burst is at the end of each period, so that the first one comes when the car is already driving.
        let (factor, left) = if phase >= period - burst { (self.bursts, period - phase) } else { (1.0, period - burst - phase) };
        (factor, time + Duration::from_nanos(u64::try_from(left).unwrap_or(u64::MAX)))
    }

    /// When work is finished that begins at `start` and takes `alone` without bursts.
    pub(super) fn finish_time(&self, start: Duration, alone: Duration) -> Duration {
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
    busy: Duration,
    is_quiet: bool,
}

/// Clock of the simulated processor: only reported work advances it.
#[derive(Debug)]
pub struct Processor {
    costs: CostModel,
    load: Load,
    state: Mutex<State>,
}

impl Processor {
    /// A processor with these costs of work under this load.
    pub fn new(costs: CostModel, load: Load) -> Self {
        Self { costs, load, state: Mutex::default() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Sets the time at which the next work begins.
    pub fn set(&self, now: Duration) {
        self.state().now = now;
    }

    /// Switches bursts off, for the time before the drive, or on again.
    pub fn set_quiet(&self, is_quiet: bool) {
        self.state().is_quiet = is_quiet;
    }

    /// Processor time spent so far, without that of other programs.
    pub fn busy_time(&self) -> Duration {
        self.state().busy
    }
}

impl Clock for Processor {
    fn now(&self) -> Duration {
        self.state().now
    }

    fn work_done(&self, phase: Phase, rays: usize) {
        if rays == 0 {
            return;
        }
        let alone = self.costs.typical(phase, rays).mul_f64(self.load.slowdown);
        let mut state = self.state();
        state.busy += alone;
        state.now = if state.is_quiet { state.now + alone } else { self.load.finish_time(state.now, alone) };
    }
}

/// Requests the answer once the processor's clock reaches a time.
pub(super) struct InterruptAt {
    pub(super) processor: Arc<Processor>,
    pub(super) time: Duration,
}

impl Interrupt for InterruptAt {
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
    fn work_takes_longer_during_bursts() {
        let load = Load { slowdown: 2.0, bursts: 10.0 };
        assert_eq!(load.finish_time(ms(0), ms(30)), ms(30));
        assert_eq!(load.finish_time(ms(900), ms(3)), ms(930), "within a burst");
        assert_eq!(load.finish_time(ms(790), ms(12)), ms(820), "10 ms before the burst, the other 2 ms within it");
        assert_eq!(load.finish_time(ms(1190), ms(3)), ms(1202), "beginning in the burst and ending after it");
        assert_eq!(Load { slowdown: 2.0, bursts: 1.0 }.finish_time(ms(900), ms(3)), ms(903));
    }
}
