//! Writes and reads the newest estimate: one process writes, others read, without locks.

use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::sync::atomic::{AtomicU64, fence};
use std::time::Duration;

use super::layout::{Estimate, FLAG_DEADLINE_MET, FLAG_INTERRUPTED, FLAG_OK, FLAG_PRESENT};
use crate::geometry::Pose2;
use crate::time::Stamp;

/// An estimate as passed to the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SharedEstimate {
    /// Stamp of the scan.
    pub stamp: Stamp,
    /// The pose of the base in the odometry frame.
    pub odom_from_base: Pose2,
    /// Standard deviation of the position, m; infinite if unknown.
    pub position_deviation: f64,
    /// Standard deviation of the heading, rad; infinite if unknown.
    pub heading_deviation: f64,
    /// Time from the scan's arrival to this estimate.
    pub elapsed: Duration,
    /// Whether the scan was matched; if not, the pose is the prediction.
    pub ok: bool,
    /// Whether the deadline was met.
    pub deadline_met: bool,
    /// Whether a request ended the refinement early.
    pub interrupted: bool,
}

/// An estimate that the node has completed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompletedEstimate {
    /// Number of completed estimates including this one; it wraps around. Its parity was the value of the topic `icp_state`.
    pub number: u32,
    /// The estimate.
    pub estimate: SharedEstimate,
}

/// The estimate is being written, so that it cannot be read now.
#[derive(Debug)]
pub(super) struct BeingWritten;

impl Estimate {
    /// Writes an estimate. There must be only one writer at a time.
    pub(super) fn write(&self, number: u32, estimate: &SharedEstimate) {
        let sequence = self.sequence.load(Relaxed);
        self.sequence.store(sequence.wrapping_add(1), Relaxed);
        // A reader that sees any of the stores below also sees the odd sequence after its own fence.
        fence(Release);
        let flag = |set: bool, flag: u32| if set { flag } else { 0 };
        let flags = FLAG_PRESENT
            | flag(estimate.ok, FLAG_OK)
            | flag(estimate.deadline_met, FLAG_DEADLINE_MET)
            | flag(estimate.interrupted, FLAG_INTERRUPTED);
        let (seconds, nanoseconds) = estimate.stamp.to_ros();
        let elapsed = u64::try_from(estimate.elapsed.as_nanos()).unwrap_or(u64::MAX);
        self.flags.store(flags, Relaxed);
        self.number.store(number, Relaxed);
        self.stamp_seconds.store(seconds, Relaxed);
        self.stamp_nanoseconds.store(nanoseconds, Relaxed);
        self.x.store(estimate.odom_from_base.x.to_bits(), Relaxed);
        self.y.store(estimate.odom_from_base.y.to_bits(), Relaxed);
        self.theta.store(estimate.odom_from_base.theta.to_bits(), Relaxed);
        self.position_deviation.store(estimate.position_deviation.to_bits(), Relaxed);
        self.heading_deviation.store(estimate.heading_deviation.to_bits(), Relaxed);
        self.elapsed_nanoseconds.store(elapsed, Relaxed);
        self.sequence.store(sequence.wrapping_add(2), Release);
    }

    /// Reads the newest estimate; `None` if there is none yet.
    pub(super) fn read(&self) -> Result<Option<CompletedEstimate>, BeingWritten> {
        let before = self.sequence.load(Acquire);
        let flags = self.flags.load(Relaxed);
        let number = self.number.load(Relaxed);
        let stamp = Stamp::from_ros(self.stamp_seconds.load(Relaxed), self.stamp_nanoseconds.load(Relaxed));
        let float = |bits: &AtomicU64| f64::from_bits(bits.load(Relaxed));
        let estimate = SharedEstimate {
            stamp,
            odom_from_base: Pose2 { x: float(&self.x), y: float(&self.y), theta: float(&self.theta) },
            position_deviation: float(&self.position_deviation),
            heading_deviation: float(&self.heading_deviation),
            elapsed: Duration::from_nanos(self.elapsed_nanoseconds.load(Relaxed)),
            ok: flags & FLAG_OK != 0,
            deadline_met: flags & FLAG_DEADLINE_MET != 0,
            interrupted: flags & FLAG_INTERRUPTED != 0,
        };
        // If any load above saw a store of a later write, the load below sees the odd sequence of that write or a later one.
        fence(Acquire);
        let after = self.sequence.load(Relaxed);
        if before != after || before % 2 == 1 {
            return Err(BeingWritten);
        }
        Ok((flags & FLAG_PRESENT != 0).then_some(CompletedEstimate { number, estimate }))
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    /// An estimate all of whose fields are computed from the number.
    fn numbered(number: u32) -> SharedEstimate {
        let value = f64::from(number);
        SharedEstimate {
            stamp: Stamp::from_ros(number, number % 1000),
            odom_from_base: Pose2 { x: value, y: -value, theta: value + 0.5 },
            position_deviation: value + 0.25,
            heading_deviation: value + 0.75,
            elapsed: Duration::from_nanos(number.into()),
            ok: number.is_multiple_of(2),
            deadline_met: number.is_multiple_of(3),
            interrupted: number.is_multiple_of(5),
        }
    }

    #[test]
    fn a_read_estimate_is_consistent_and_never_older_than_the_one_before() {
        const ESTIMATES: u32 = 2_000_000;
        let shared = Estimate::default();
        assert_eq!(shared.read().unwrap(), None);
        thread::scope(|scope| {
            scope.spawn(|| (1..=ESTIMATES).for_each(|number| shared.write(number, &numbered(number))));
            let mut newest = 0;
            while newest < ESTIMATES {
                let Ok(Some(completed)) = shared.read() else { continue };
                assert_eq!(completed.estimate, numbered(completed.number));
                assert!(completed.number >= newest);
                newest = completed.number;
            }
        });
    }
}
