//! Heading from an inertial measurement unit (IMU).

use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

use super::wheel::{WheelOdometry, WheelSample};

/// Maximum time over which rates are integrated, s: over a longer gap the rate is unknown.
const MAX_STEP: f64 = 0.5;

/// The planar part of one IMU reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingReading {
    /// Time of the measurement.
    pub stamp: Stamp,
    /// Heading relative to any fixed direction, rad; `None` if the IMU measures only rates.
    pub yaw: Option<f64>,
    /// Yaw rate, counter-clockwise seen from above, rad/s.
    pub rate: f64,
}

/// The latest readings. If they are rates only, these are integrated.
#[derive(Clone, Debug, Default)]
pub struct ImuHeading {
    /// Poses with a heading only.
    rotations: WheelOdometry,
    last: Option<(HeadingReading, f64)>,
}

impl ImuHeading {
    /// Adds a reading.
    pub fn push(&mut self, reading: HeadingReading) {
        let yaw = reading.yaw.unwrap_or_else(|| self.integrated(&reading));
        let twist = Twist2 { omega: reading.rate, ..Twist2::default() };
        self.rotations.push(WheelSample { stamp: reading.stamp, pose: Pose2::new(0.0, 0.0, yaw), twist: Some(twist) });
        self.last = Some((reading, yaw));
    }

    fn integrated(&self, reading: &HeadingReading) -> f64 {
        let Some((last, yaw)) = self.last else { return 0.0 };
        let seconds = reading.stamp.seconds_since(last.stamp);
        let known = (0.0..=MAX_STEP).contains(&seconds);
        if known { yaw + 0.5 * (last.rate + reading.rate) * seconds } else { yaw }
    }

    /// The rotation from one time to another, rad, less than half a turn; `None` if the readings do not cover it.
    pub fn rotation(&self, from: Stamp, to: Stamp) -> Option<f64> {
        self.rotations.motion(from, to).map(|motion| motion.theta)
    }

    /// Whether readings are arriving, but the one for `stamp` has not arrived yet.
    pub fn is_due(&self, stamp: Stamp) -> bool {
        self.rotations.is_due(stamp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotation(heading: &ImuHeading, from: f64, to: f64) -> Option<f64> {
        heading.rotation(Stamp::from_seconds(from), Stamp::from_seconds(to))
    }

    fn heading(readings: impl IntoIterator<Item = (f64, Option<f64>, f64)>) -> ImuHeading {
        let mut heading = ImuHeading::default();
        for (seconds, yaw, rate) in readings {
            heading.push(HeadingReading { stamp: Stamp::from_seconds(seconds), yaw, rate });
        }
        heading
    }

    #[test]
    fn headings_are_interpolated_across_pi() {
        let heading = heading([(0.0, Some(3.0), 1.0), (0.1, Some(3.1), 1.0), (0.2, Some(-3.083), 1.0)]);
        assert!((rotation(&heading, 0.05, 0.2).unwrap() - 0.15).abs() < 1e-3);
        assert!((rotation(&heading, 0.1, 0.25).unwrap() - 0.15).abs() < 1e-3, "extrapolated by the rate");
        assert_eq!(rotation(&heading, 0.1, 2.0), None);
    }

    #[test]
    fn rates_alone_are_integrated() {
        let heading = heading((0..=20).map(|i| (f64::from(i) * 0.01, None, f64::from(i) * 0.1)));
        assert!((rotation(&heading, 0.0, 0.2).unwrap() - 0.2).abs() < 1e-9);
        assert!((rotation(&heading, 0.1, 0.2).unwrap() - 0.15).abs() < 1e-9);
    }
}
