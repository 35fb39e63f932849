//! The sweep of a scan: its rays are measured one after the other while the robot moves.

use super::OdometryKnobs;
use crate::geometry::{Pose2, Twist2};
use crate::knobs::Seconds;
use crate::scan::Scan;
use crate::time::Stamp;

/// When the rays of a scan were measured.
#[derive(Clone, Copy, Debug)]
pub struct Sweep {
    /// Time of the first ray relative to the scan's stamp, s.
    first_ray: f64,
    /// Time of the last ray relative to the first one, s; negative if the last ray was measured first.
    duration: f64,
}

impl Sweep {
    /// The sweep of a scan that is to be deskewed; `None` if it was measured at once or deskewing is off. With the duration from
    /// the message, the first ray is measured at the stamp; with a negative duration from the parameter, the last ray is.
    pub fn of(scan: &Scan, knobs: &OdometryKnobs) -> Option<Self> {
        let sweep = match knobs.scan_duration {
            Some(Seconds(duration)) => Self { first_ray: (-duration).max(0.0), duration },
            None => Self { first_ray: 0.0, duration: scan.sweep_duration() },
        };
        (knobs.deskew && sweep.duration != 0.0).then_some(sweep)
    }

    /// Duration, s.
    pub fn seconds(&self) -> f64 {
        self.duration.abs()
    }

    /// Start and end, for a scan of this stamp.
    pub fn span(&self, stamp: Stamp) -> (Stamp, Stamp) {
        let start = stamp.offset_by(self.first_ray.min(self.first_ray + self.duration));
        (start, start.offset_by(self.seconds()))
    }

    /// The scan as it would have been measured at its stamp, if the base moves by `motion` from the start to the end of the
    /// sweep.
    pub fn deskewed(&self, scan: &Scan, base_from_laser: &Pose2, motion: &Pose2) -> Scan {
        let laser_motion = base_from_laser.inverse() * *motion * *base_from_laser;
        scan.undistorted(&Twist2::from_motion(&laser_motion, self.seconds()), self.first_ray, self.duration)
    }
}
