//! Message stamps: absolute times in whole nanoseconds, as in ROS, and the check of how the stamps of successive scans continue.

mod continuity;

use std::fmt;

pub use continuity::{Continuity, Step};

const NANOSECONDS_PER_SECOND: i64 = 1_000_000_000;

/// The absolute time of a measurement, in nanoseconds since the epoch of its clock (wall, simulation or bag).
///
/// It is an integer because an `f64` resolves only 0.24 microseconds at the current epoch, and stamps must be published exactly
/// as they were received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp(i64);

impl Stamp {
    /// Creates a stamp from the two fields of a ROS `time`.
    pub fn from_ros(seconds: u32, nanoseconds: u32) -> Self {
        Self(i64::from(seconds) * NANOSECONDS_PER_SECOND + i64::from(nanoseconds))
    }

    /// Creates a stamp from nanoseconds since the epoch.
    pub const fn from_nanoseconds(nanoseconds: i64) -> Self {
        Self(nanoseconds)
    }

    /// Nanoseconds since the epoch.
    pub const fn nanoseconds(self) -> i64 {
        self.0
    }

    /// Creates a stamp from seconds since the epoch, rounded to whole nanoseconds.
    #[allow(clippy::cast_possible_truncation)] // saturates, as intended
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * NANOSECONDS_PER_SECOND as f64).round() as i64)
    }

    /// Seconds since the epoch. This is rounded: use it only for plots and for files with floating-point seconds.
    pub fn seconds(self) -> f64 {
        self.0 as f64 / NANOSECONDS_PER_SECOND as f64
    }

    /// The two fields of a ROS `time`; stamps outside its range (1970 to 2106) saturate.
    pub fn to_ros(self) -> (u32, u32) {
        let seconds = self.0.div_euclid(NANOSECONDS_PER_SECOND);
        let nanoseconds = self.0.rem_euclid(NANOSECONDS_PER_SECOND);
        match u32::try_from(seconds) {
            Ok(seconds) => (seconds, u32::try_from(nanoseconds).unwrap_or(0)),
            Err(_) if seconds < 0 => (0, 0),
            Err(_) => (u32::MAX, 999_999_999),
        }
    }

    /// Seconds from `earlier` to `self`, negative if `earlier` is later. Exact to the nanosecond.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 / NANOSECONDS_PER_SECOND as f64
    }

    /// The stamp `seconds` later (earlier if negative).
    #[must_use]
    #[allow(clippy::cast_possible_truncation)] // saturates, as intended
    pub fn offset_by(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * NANOSECONDS_PER_SECOND as f64).round() as i64))
    }
}

/// Decimal seconds with nine digits, as in TUM files.
impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let magnitude = self.0.unsigned_abs();
        let per_second = NANOSECONDS_PER_SECOND.unsigned_abs();
        write!(f, "{sign}{}.{:09}", magnitude / per_second, magnitude % per_second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prints_and_converts_without_losing_a_nanosecond() {
        let stamp = Stamp::from_ros(1_795_374_577, 83_470_347);
        assert_eq!(stamp.to_string(), "1795374577.083470347");
        assert_eq!(stamp.to_ros(), (1_795_374_577, 83_470_347));
        assert_eq!(Stamp::from_nanoseconds(-1_500_000_000).to_string(), "-1.500000000");
    }

    #[test]
    fn differences_are_exact_and_ros_times_saturate() {
        let stamp = Stamp::from_ros(1_795_374_577, 1);
        assert_eq!(stamp.offset_by(0.25).seconds_since(stamp).to_bits(), 0.25_f64.to_bits());
        assert_eq!(Stamp::from_nanoseconds(-1).to_ros(), (0, 0));
        assert_eq!(Stamp::from_nanoseconds(i64::MAX).to_ros(), (u32::MAX, 999_999_999));
    }
}
