//! How fast the car may go at each place of a path.

use super::path::Path;

/// Distance between the places, m.
const SPACING: f64 = 0.2;

/// What limits the speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedLimits {
    /// Nowhere faster than this, m/s.
    pub top: f64,
    /// Lateral acceleration in curves, m/s^2.
    pub lateral_acceleration: f64,
    /// Braking that is planned with, m/s^2.
    pub braking: f64,
}

/// The speed at places all along a path: that of the path where it says one, never more than curves allow, and always such that braking
/// brings the car to what is ahead: a curve, a slower stretch, or the end.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedProfile {
    speeds: Vec<f64>,
    spacing: f64,
    is_closed: bool,
}

impl SpeedProfile {
    /// Of a path.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
    pub fn new(path: &Path, limits: &SpeedLimits) -> Self {
        let steps = (path.length() / SPACING).ceil().max(1.0) as usize;
        let spacing = path.length() / steps as f64;
        let count = if path.is_closed() { steps } else { steps + 1 };
        let allowed = |place: usize| {
            let along = place as f64 * spacing;
            let in_curve = (limits.lateral_acceleration / path.curvature(along).abs()).sqrt();
            path.speed(along).unwrap_or(f64::INFINITY).min(in_curve).min(limits.top)
        };
        let mut speeds: Vec<f64> = (0..count).map(allowed).collect();
        let gain = 2.0 * limits.braking * spacing;
        let mut next = if path.is_closed() { f64::INFINITY } else { 0.0 };
        // Twice round a closed path: what is ahead of its last place is its first.
        let rounds = if path.is_closed() { 2 } else { 1 };
        if !path.is_closed() {
            speeds[count - 1] = 0.0;
        }
        for place in (0..count).rev().cycle().take(rounds * count) {
            speeds[place] = speeds[place].min((next * next + gain).sqrt());
            next = speeds[place];
        }
        Self { speeds, spacing, is_closed: path.is_closed() }
    }

    /// So far along the path, m/s; between two places as at constant acceleration.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a place of the path
    pub fn at(&self, along: f64) -> f64 {
        let count = self.speeds.len();
        let place = (along / self.spacing).max(0.0);
        let (here, share) = (place.floor() as usize, place.fract());
        if !self.is_closed && here + 1 >= count {
            return self.speeds[count - 1];
        }
        let squared = |index: usize| self.speeds[index % count].powi(2);
        (squared(here) * (1.0 - share) + squared(here + 1) * share).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::path::Waypoint;
    use crate::control::path::tests::{circle, waypoints};

    const LIMITS: SpeedLimits = SpeedLimits { top: 7.0, lateral_acceleration: 4.0, braking: 2.0 };

    #[test]
    fn curves_limit_the_speed_and_ends_are_braked_for() {
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
    fn the_path_may_ask_for_less() {
        let slow =
            |x: f64| Waypoint { point: crate::geometry::Point::new(x, 0.0), speed: Some(if x < 10.0 { 3.0 } else { 1.0 }) };
        let points: Vec<_> = (0..40).map(|i| slow(f64::from(i))).collect();
        let profile = SpeedProfile::new(&Path::new(&points, false).unwrap(), &LIMITS);
        assert!((profile.at(2.0) - 3.0).abs() < 1e-9 && (profile.at(9.0) - 5.0_f64.sqrt()).abs() < 0.1);
        assert!((profile.at(20.0) - 1.0).abs() < 1e-9);
    }
}
