//! A pose set by a user, for example in `RViz`. It is kept until the first scan taken after it.

use std::time::Duration;

use crate::messages::std_msgs::Header;
use crate::time::Stamp;

/// Maximum difference of two stamps of the same clock, s. A larger difference means two clocks, such as the scans of a bag and a
/// pose set today.
const MAX_CLOCK_DIFFERENCE: f64 = 1.0;

/// A pose, possibly with its covariance, and when it was set.
#[derive(Clone, Copy, Debug)]
pub(super) struct InitialPose<T> {
    pub(super) pose: T,
    stamp: Stamp,
    /// Reading of the clock when the message arrived.
    arrival: Duration,
}

impl<T> InitialPose<T> {
    /// A pose from a message that arrived when the clock read `arrival`.
    pub(super) fn new(pose: T, header: &Header, arrival: Duration) -> Self {
        Self { pose, stamp: header.stamp.into(), arrival }
    }

    /// Whether a scan was taken after the pose was set. Compares the arrival times, and also the stamps if they are of the same
    /// clock.
    pub(super) fn precedes(&self, scan: Stamp, arrival: Duration) -> bool {
        arrival >= self.arrival && (!self.is_same_clock(scan) || scan >= self.stamp)
    }

    /// When the robot was at the pose, on the clock of the stamp of a scan that arrived when the clock read `arrival`.
    pub(super) fn time_on_scan_clock(&self, scan: Stamp, arrival: Duration) -> Stamp {
        if self.is_same_clock(scan) { self.stamp } else { scan.offset_by(-arrival.saturating_sub(self.arrival).as_secs_f64()) }
    }

    fn is_same_clock(&self, scan: Stamp) -> bool {
        self.stamp != Stamp::default() && scan.seconds_since(self.stamp).abs() <= MAX_CLOCK_DIFFERENCE
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
    fn scans_with_an_earlier_stamp_or_arrival_do_not_follow_the_pose() {
        let pose = set(10.0, 500);
        assert!(!precedes(&pose, 9.98, 510), "taken before the pose, arrived after it");
        assert!(!precedes(&pose, 10.01, 490), "arrived before the pose");
        assert!(precedes(&pose, 10.01, 510));
        assert_eq!(pose.time_on_scan_clock(Stamp::from_seconds(10.01), Duration::from_millis(510)), Stamp::from_seconds(10.0));
    }

    #[test]
    fn without_a_stamp_or_with_another_clock_arrival_times_are_compared() {
        for pose in [set(0.0, 500), set(1e9, 500)] {
            assert!(precedes(&pose, 10.0, 510) && !precedes(&pose, 10.0, 490));
            assert_eq!(pose.time_on_scan_clock(Stamp::from_seconds(10.0), Duration::from_millis(510)), Stamp::from_seconds(9.99));
        }
    }
}
