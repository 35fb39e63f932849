//! The clock that time contracts are kept by: injected, so that replays can be exact to the last bit.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::cost_model::Phase;

/// A clock that never goes back. Only differences of its readings mean anything.
pub trait Clock: Send + Sync {
    /// Time since the clock's origin.
    fn now(&self) -> Duration;

    /// Work of a phase on so many rays has just been done. A clock of a machine that is but modelled moves on by what it would have taken.
    fn worked(&self, _phase: Phase, _rays: usize) {}
}

/// The machine's monotonic clock.
#[derive(Debug)]
pub struct MonotonicClock {
    origin: Instant,
}

impl Default for MonotonicClock {
    fn default() -> Self {
        Self { origin: Instant::now() }
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> Duration {
        self.origin.elapsed()
    }
}

/// The processor time of the thread that reads it: what others on the same machine take away does not count. A thread that sleeps
/// stops it.
#[cfg(all(feature = "cli", target_os = "linux"))]
#[derive(Clone, Copy, Debug, Default)]
pub struct ProcessorClock;

#[cfg(all(feature = "cli", target_os = "linux"))]
impl Clock for ProcessorClock {
    fn now(&self) -> Duration {
        // Never negative, and a second has fewer than 2^32 nanoseconds.
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Duration::new(time.tv_sec.unsigned_abs(), u32::try_from(time.tv_nsec).unwrap_or_default())
    }
}

/// A clock that moves on by the same tick at every reading: time as a count of readings, the same in every run.
#[derive(Debug)]
pub struct VirtualClock {
    tick: Duration,
    readings: AtomicU64,
}

impl VirtualClock {
    /// A clock that advances by `tick` per reading.
    pub const fn new(tick: Duration) -> Self {
        Self { tick, readings: AtomicU64::new(0) }
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> Duration {
        let readings = self.readings.fetch_add(1, Ordering::Relaxed);
        Duration::from_nanos(readings.saturating_mul(u64::try_from(self.tick.as_nanos()).unwrap_or(u64::MAX)))
    }
}
