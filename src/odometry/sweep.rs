//! The sweep of a scan, whose rays were taken one after the other while the robot moved.

use super::OdometryKnobs;
use crate::geometry::{Pose2, Twist2};
use crate::knobs::Seconds;
use crate::scan::Scan;
use crate::time::Stamp;

/// When the rays of a scan were taken.
#[derive(Clone, Copy, Debug)]
pub struct Sweep {
    /// When the first ray was taken, after the scan's stamp, s.
    first_ray: f64,
    /// When the last ray was taken, after the first one, s: less than zero where it came first.
    duration: f64,
}

impl Sweep {
    /// Of a scan that is to be straightened; `None`: it is of one moment, or may stay as it is. The message says when its rays come after
    /// its first one; the parameter, less than zero, that the last one came first, at the stamp.
    pub fn of(scan: &Scan, knobs: &OdometryKnobs) -> Option<Self> {
        let sweep = match knobs.scan_duration {
            Some(Seconds(duration)) => Self { first_ray: (-duration).max(0.0), duration },
            None => Self { first_ray: 0.0, duration: scan.sweep_duration() },
        };
        (knobs.deskew && sweep.duration != 0.0).then_some(sweep)
    }

    /// How long it took, s.
    pub fn seconds(&self) -> f64 {
        self.duration.abs()
    }

    /// When it began and ended, for a scan of this stamp.
    pub fn span(&self, stamp: Stamp) -> (Stamp, Stamp) {
        let start = stamp.offset_by(self.first_ray.min(self.first_ray + self.duration));
        (start, start.offset_by(self.seconds()))
    }

    /// The scan as it would have been seen at its stamp, when the base has moved like this from the beginning of the sweep to its end.
    pub fn straightened(&self, scan: &Scan, base_from_laser: &Pose2, motion: &Pose2) -> Scan {
        let laser_motion = base_from_laser.inverse() * *motion * *base_from_laser;
        scan.undistorted(&Twist2::of_motion(&laser_motion, self.seconds()), self.first_ray, self.duration)
    }
}
