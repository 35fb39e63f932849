//! Speed profile along a path.

use super::path::Path;

/// Distance between the samples of the profile, m.
const SPACING: f64 = 0.2;

/// Limits of the speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedLimits {
    /// Top speed, m/s.
    pub top: f64,
    /// Maximum lateral acceleration, m/s^2.
    pub lateral_acceleration: f64,
    /// Planned deceleration, m/s^2.
    pub braking: f64,
}

/// The speed along a path: the speed that the path requests, limited by the curvature, and such that the car can brake in time
/// for everything ahead: a curve, a slower section or the end.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedProfile {
    speeds: Vec<f64>,
    spacing: f64,
    is_closed: bool,
}

impl SpeedProfile {
    /// The speed profile of a path.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
    pub fn new(path: &Path, limits: &SpeedLimits) -> Self {
        let steps = (path.length() / SPACING).ceil().max(1.0) as usize;
        let spacing = path.length() / steps as f64;
        let count = if path.is_closed() { steps } else { steps + 1 };
        let allowed = |sample: usize| {
            let along = sample as f64 * spacing;
            let curve_limit = (limits.lateral_acceleration / path.curvature(along).abs()).sqrt();
            path.speed(along).unwrap_or(f64::INFINITY).min(curve_limit).min(limits.top)
        };
        let mut speeds: Vec<f64> = (0..count).map(allowed).collect();
        let gain = 2.0 * limits.braking * spacing;
        let mut next = if path.is_closed() { f64::INFINITY } else { 0.0 };
        // Two rounds of a closed path: its last sample is followed by its first.
        let rounds = if path.is_closed() { 2 } else { 1 };
        if !path.is_closed() {
            speeds[count - 1] = 0.0;
        }
        for sample in (0..count).rev().cycle().take(rounds * count) {
            speeds[sample] = speeds[sample].min((next * next + gain).sqrt());
            next = speeds[sample];
        }
        Self { speeds, spacing, is_closed: path.is_closed() }
    }

    /// Speed at an arc length, m/s; interpolated with constant acceleration between two samples.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a sample index
    pub fn at(&self, along: f64) -> f64 {
        let count = self.speeds.len();
        let position = (along / self.spacing).max(0.0);
        let (here, fraction) = (position.floor() as usize, position.fract());
        if !self.is_closed && here + 1 >= count {
            return self.speeds[count - 1];
        }
        let squared = |index: usize| self.speeds[index % count].powi(2);
        (squared(here) * (1.0 - fraction) + squared(here + 1) * fraction).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::path::Waypoint;
    use crate::control::path::tests::{circle, waypoints};

    const LIMITS: SpeedLimits = SpeedLimits { top: 7.0, lateral_acceleration: 4.0, braking: 2.0 };

    #[test]
    fn curves_limit_the_speed_and_the_car_brakes_for_the_end() {
        let round = SpeedProfile::new(&circle(4.0, 200), &LIMITS);
        assert!((0..300).all(|i| (round.at(f64::from(i) * 0.1) - 4.0).abs() < 0.15));
        let line = SpeedProfile::new(&Path::new(&waypoints(&[(0.0, 0.0), (20.0, 0.0)]), false).unwrap(), &LIMITS);
        for along in [0.0, 3.1, 7.75, 12.0, 19.9, 20.0] {
            let braking = (2.0 * 2.0 * (20.0_f64 - along)).sqrt().min(7.0);
            assert!((line.at(along) - braking).abs() < 0.15, "at {along}: {} {braking}", line.at(along));
        }
        assert_eq!(line.at(25.0).to_bits(), 0.0_f64.to_bits());
    }

    #[test]
    fn the_path_may_request_less() {
        let slow =
            |x: f64| Waypoint { point: crate::geometry::Point::new(x, 0.0), speed: Some(if x < 10.0 { 3.0 } else { 1.0 }) };
        let points: Vec<_> = (0..40).map(|i| slow(f64::from(i))).collect();
        let profile = SpeedProfile::new(&Path::new(&points, false).unwrap(), &LIMITS);
        assert!((profile.at(2.0) - 3.0).abs() < 1e-9 && (profile.at(9.0) - 5.0_f64.sqrt()).abs() < 0.1);
        assert!((profile.at(20.0) - 1.0).abs() < 1e-9);
    }
}
