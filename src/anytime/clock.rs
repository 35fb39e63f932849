//! The clock that time contracts are kept by: injected, so that replays can be exact to the last bit.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A clock that never goes back. Only differences of its readings mean anything.
pub trait Clock: Send + Sync {
    /// Time since the clock's origin.
    fn now(&self) -> Duration;
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
