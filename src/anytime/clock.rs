//! Clocks for time contracts. They are injected, so that replays can be reproducible to the last bit.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::cost_model::Phase;

/// A monotonic clock. Only differences between its readings are meaningful.
pub trait Clock: Send + Sync {
    /// Time since the clock's origin.
    fn now(&self) -> Duration;

    /// Reports that work of a phase on this many rays has just been done. A simulated clock advances by the modelled cost.
    fn work_done(&self, _phase: Phase, _rays: usize) {}
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

/// CPU time of the calling thread: preemption by other processes does not count, nor does sleep.
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

/// A clock that advances by the same tick at every reading, so that it is the same in every run.
#[derive(Debug)]
pub struct VirtualClock {
    tick: Duration,
    readings: AtomicU64,
}

impl VirtualClock {
    /// Creates a clock that advances by `tick` per reading.
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
