//! The heading by an inertial measurement unit (IMU).

use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

use super::wheel::{WheelOdometry, WheelSample};

/// Over a longer time than this nobody knows what the rate was in between, s.
const LONGEST_STEP: f64 = 0.5;

/// One reading of an IMU, as far as it matters in the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingReading {
    /// When it was measured.
    pub stamp: Stamp,
    /// The heading, rad, from any fixed direction; `None`: it measures rates only.
    pub yaw: Option<f64>,
    /// Yaw rate, counter-clockwise seen from above, rad/s.
    pub rate: f64,
}

/// The last readings. Where they are rates only, these are summed up.
#[derive(Clone, Debug, Default)]
pub struct Heading {
    /// Poses that only turn.
    turns: WheelOdometry,
    last: Option<(HeadingReading, f64)>,
}

impl Heading {
    /// Adds a reading.
    pub fn push(&mut self, reading: HeadingReading) {
        let yaw = reading.yaw.unwrap_or_else(|| self.summed_up(&reading));
        let twist = Twist2 { omega: reading.rate, ..Twist2::default() };
        self.turns.push(WheelSample { stamp: reading.stamp, pose: Pose2::new(0.0, 0.0, yaw), twist: Some(twist) });
        self.last = Some((reading, yaw));
    }

    fn summed_up(&self, reading: &HeadingReading) -> f64 {
        let Some((last, yaw)) = self.last else { return 0.0 };
        let seconds = reading.stamp.seconds_since(last.stamp);
        let known = (0.0..=LONGEST_STEP).contains(&seconds);
        if known { yaw + 0.5 * (last.rate + reading.rate) * seconds } else { yaw }
    }

    /// The turn from one time to another, rad, of less than half a turn; `None` where the readings do not cover it.
    pub fn turn(&self, from: Stamp, to: Stamp) -> Option<f64> {
        self.turns.motion(from, to).map(|motion| motion.theta)
    }

    /// Whether readings come, and the one for `stamp` has yet to.
    pub fn is_due(&self, stamp: Stamp) -> bool {
        self.turns.is_due(stamp)
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turn(heading: &Heading, from: f64, to: f64) -> Option<f64> {
        heading.turn(Stamp::from_seconds(from), Stamp::from_seconds(to))
    }

    fn heading(readings: impl IntoIterator<Item = (f64, Option<f64>, f64)>) -> Heading {
        let mut heading = Heading::default();
        for (seconds, yaw, rate) in readings {
            heading.push(HeadingReading { stamp: Stamp::from_seconds(seconds), yaw, rate });
        }
        heading
    }

    #[test]
    fn headings_are_interpolated_across_the_half_turn() {
        let heading = heading([(0.0, Some(3.0), 1.0), (0.1, Some(3.1), 1.0), (0.2, Some(-3.083), 1.0)]);
        assert!((turn(&heading, 0.05, 0.2).unwrap() - 0.15).abs() < 1e-3);
        assert!((turn(&heading, 0.1, 0.25).unwrap() - 0.15).abs() < 1e-3, "carried on by the rate");
        assert_eq!(turn(&heading, 0.1, 2.0), None);
    }

    #[test]
    fn rates_alone_are_summed_up() {
        let heading = heading((0..=20).map(|i| (f64::from(i) * 0.01, None, f64::from(i) * 0.1)));
        assert!((turn(&heading, 0.0, 0.2).unwrap() - 0.2).abs() < 1e-9);
        assert!((turn(&heading, 0.1, 0.2).unwrap() - 0.15).abs() < 1e-9);
    }
}
