//! A pose set by a user, as in `RViz`, until the first scan after it.

use std::time::Duration;

use crate::messages::std_msgs::Header;
use crate::time::Stamp;

/// Stamps farther apart than this, s, are of different clocks: a bag's scans and a pose set today.
const SAME_CLOCK: f64 = 1.0;

/// A pose, what is known of it, and when it was set.
#[derive(Clone, Copy, Debug)]
pub(super) struct InitialPose<T> {
    pub(super) pose: T,
    stamp: Stamp,
    /// Reading of the clock when it came.
    arrival: Duration,
}

impl<T> InitialPose<T> {
    /// The pose of a message that came when the clock read `arrival`.
    pub(super) fn new(pose: T, header: &Header, arrival: Duration) -> Self {
        Self { pose, stamp: header.stamp.into(), arrival }
    }

    /// Whether a scan was taken after it was set: by its arrival, and by its stamp where that is of the same clock.
    pub(super) fn precedes(&self, scan: Stamp, arrival: Duration) -> bool {
        arrival >= self.arrival && (!self.is_of_clock(scan) || scan >= self.stamp)
    }

    /// When the robot was there, by the clock of a scan that came when the clock read `arrival`.
    pub(super) fn held_at(&self, scan: Stamp, arrival: Duration) -> Stamp {
        if self.is_of_clock(scan) { self.stamp } else { scan.offset_by(-arrival.saturating_sub(self.arrival).as_secs_f64()) }
    }

    fn is_of_clock(&self, scan: Stamp) -> bool {
        self.stamp != Stamp::default() && scan.seconds_since(self.stamp).abs() <= SAME_CLOCK
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(seconds: f64, arrival: u64) -> InitialPose<()> {
        let header = Header { stamp: Stamp::from_seconds(seconds).into(), ..Header::default() };
        InitialPose::new((), &header, Duration::from_millis(arrival))
    }

    fn precedes(pose: &InitialPose<()>, scan: f64, arrival: u64) -> bool {
        pose.precedes(Stamp::from_seconds(scan), Duration::from_millis(arrival))
    }

    #[test]
    fn scans_taken_before_by_stamp_or_by_arrival_are_of_before() {
        let pose = set(10.0, 500);
        assert!(!precedes(&pose, 9.98, 510), "taken before, on its way");
        assert!(!precedes(&pose, 10.01, 490), "it was here before");
        assert!(precedes(&pose, 10.01, 510));
        assert_eq!(pose.held_at(Stamp::from_seconds(10.01), Duration::from_millis(510)), Stamp::from_seconds(10.0));
    }

    #[test]
    fn without_a_stamp_or_by_another_clock_the_arrival_counts() {
        for pose in [set(0.0, 500), set(1e9, 500)] {
            assert!(precedes(&pose, 10.0, 510) && !precedes(&pose, 10.0, 490));
            assert_eq!(pose.held_at(Stamp::from_seconds(10.0), Duration::from_millis(510)), Stamp::from_seconds(9.99));
        }
    }
}
