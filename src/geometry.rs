//! Poses and points in the plane.
//!
//! A pose named `odom_from_base` transforms points from the base frame to the odom frame, so that adjacent frame names cancel:
//! `odom_from_base * base_from_laser` is `odom_from_laser`.

use std::f64::consts::{PI, TAU};
use std::ops::Mul;

use nalgebra::{Matrix3, Vector2, Vector3};

/// A point or displacement in the plane, m.
pub type Point = Vector2<f64>;

/// Covariance of a pose in the order x, y, heading; units m^2, m rad, rad^2.
pub type PoseCovariance = Matrix3<f64>;

/// Wraps an angle into (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle; // unchanged to the last bit: an angle in range must not be rounded
    }
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// Rotates a vector by 90 degrees counter-clockwise.
pub fn perpendicular(v: Point) -> Point {
    Point::new(-v.y, v.x)
}

/// A pose in the plane: a position and a heading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose2 {
    /// Position, m.
    pub x: f64,
    /// Position, m.
    pub y: f64,
    /// Heading, rad, in (-pi, pi].
    pub theta: f64,
}

impl Pose2 {
    /// The identity.
    pub const IDENTITY: Self = Self { x: 0.0, y: 0.0, theta: 0.0 };

    /// Creates a pose from metres and radians; wraps the heading into (-pi, pi].
    pub fn new(x: f64, y: f64, theta: f64) -> Self {
        Self { x, y, theta: wrap_angle(theta) }
    }

    /// The position.
    pub fn translation(&self) -> Point {
        Point::new(self.x, self.y)
    }

    /// The transform of points, with sine and cosine computed once.
    pub fn transform(&self) -> RigidTransform {
        let (sin, cos) = self.theta.sin_cos();
        RigidTransform { cos, sin, x: self.x, y: self.y }
    }

    /// The inverse: `b_from_a` of `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        Self::new(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.theta)
    }

    /// The motion from `self` to `other` in the frame of `self`: `self.inverse() * other`.
    #[must_use]
    pub fn between(&self, other: &Self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        let (dx, dy) = (other.x - self.x, other.y - self.y);
        Self::new(cos * dx + sin * dy, cos * dy - sin * dx, other.theta - self.theta)
    }

    /// The difference `other - self` by coordinate: m, m, and rad in (-pi, pi].
    pub fn difference(&self, other: &Self) -> Vector3<f64> {
        Vector3::new(other.x - self.x, other.y - self.y, wrap_angle(other.theta - self.theta))
    }

    /// Interpolates between `self` (fraction 0) and `other` (fraction 1): the position along the straight line, the heading along
    /// the shorter arc. Fractions outside 0..1 extrapolate.
    #[must_use]
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self::new(
            self.x + fraction * (other.x - self.x),
            self.y + fraction * (other.y - self.y),
            self.theta + fraction * wrap_angle(other.theta - self.theta),
        )
    }

    /// Distance of the position from the origin, m.
    pub fn distance(&self) -> f64 {
        self.x.hypot(self.y)
    }

    /// Size of a motion: distance plus rotation, where 1 rad counts as 1 m. Measures how much the views from its two ends differ.
    pub fn magnitude(&self) -> f64 {
        self.distance() + self.theta.abs()
    }

    /// Whether `other` is nearer than `distance`, m, and its heading differs by less than `angle`, rad.
    pub fn is_near(&self, other: &Self, distance: f64, angle: f64) -> bool {
        let motion = self.between(other);
        motion.distance() < distance && motion.theta.abs() < angle
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.theta.is_finite()
    }
}

/// Composition: `a_from_b * b_from_c` is `a_from_c`.
impl Mul for Pose2 {
    type Output = Self;

    #[allow(clippy::suspicious_arithmetic_impl)] // headings add when transforms multiply
    fn mul(self, rhs: Self) -> Self {
        let position = self.transform().apply(rhs.translation());
        Self::new(position.x, position.y, self.theta + rhs.theta)
    }
}

/// A [`Pose2`] with precomputed sine and cosine, to transform many points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidTransform {
    cos: f64,
    sin: f64,
    x: f64,
    y: f64,
}

impl RigidTransform {
    /// Transforms a point into the parent frame.
    #[inline]
    pub fn apply(&self, p: Point) -> Point {
        Point::new(self.cos * p.x - self.sin * p.y + self.x, self.sin * p.x + self.cos * p.y + self.y)
    }

    /// Rotates a direction into the parent frame.
    #[inline]
    pub fn rotate(&self, v: Point) -> Point {
        Point::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y)
    }
}

/// A velocity in the plane, in the moving frame (REP 105: the child frame of an odometry message).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist2 {
    /// Forward, m/s.
    pub vx: f64,
    /// To the left, m/s.
    pub vy: f64,
    /// Counter-clockwise, rad/s.
    pub omega: f64,
}

impl Twist2 {
    /// The constant twist that produces `motion` (in its start frame) in `seconds`.
    pub fn from_motion(motion: &Pose2, seconds: f64) -> Self {
        // Inverse of `motion` below: the chord rotated back by half the angle and stretched to the length of the arc.
        let half = 0.5 * motion.theta;
        let stretch = if half.abs() < 1e-9 { 1.0 } else { half / half.sin() };
        let (sin, cos) = half.sin_cos();
        Self {
            vx: stretch * (cos * motion.x + sin * motion.y) / seconds,
            vy: stretch * (cos * motion.y - sin * motion.x) / seconds,
            omega: motion.theta / seconds,
        }
    }

    /// The motion of this twist over `seconds`: an arc of constant curvature.
    pub fn motion(&self, seconds: f64) -> Pose2 {
        let half = 0.5 * self.omega * seconds;
        let shrink = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
        let (sin, cos) = half.sin_cos();
        let (dx, dy) = (shrink * self.vx * seconds, shrink * self.vy * seconds);
        Pose2::new(cos * dx - sin * dy, sin * dx + cos * dy, 2.0 * half)
    }

    /// Interpolates between `self` (fraction 0) and `other` (fraction 1).
    #[must_use]
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        let mixed = |from: f64, to: f64| from + fraction * (to - from);
        Self { vx: mixed(self.vx, other.vx), vy: mixed(self.vy, other.vy), omega: mixed(self.omega, other.omega) }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.vx.is_finite() && self.vy.is_finite() && self.omega.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Pose2> {
        (-50.0..50.0, -50.0..50.0, -PI..PI).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
    }

    fn assert_same(a: Pose2, b: Pose2) {
        assert!((a.x - b.x).abs() < 1e-10 && (a.y - b.y).abs() < 1e-10, "{a:?} is not {b:?}");
        assert!(wrap_angle(a.theta - b.theta).abs() < 1e-10, "{a:?} is not {b:?}");
    }

    proptest! {
        #[test]
        fn inverse_and_between_undo_composition(a in poses(), b in poses()) {
            assert_same(a * a.inverse(), Pose2::IDENTITY);
            assert_same(a * a.between(&b), b);
            assert_same(a.inverse() * b, a.between(&b));
        }

        #[test]
        fn interpolation_starts_and_ends_at_the_given_poses(a in poses(), b in poses()) {
            assert_same(a.interpolate(&b, 0.0), a);
            assert_same(a.interpolate(&b, 1.0), b);
        }

        #[test]
        fn a_twist_reproduces_its_motion(x in -2.0..2.0, y in -2.0..2.0, theta in -3.0..3.0, dt in 0.01..1.0) {
            let motion = Pose2::new(x, y, theta);
            assert_same(Twist2::from_motion(&motion, dt).motion(dt), motion);
        }

        #[test]
        fn wrapped_angles_stay_in_range(angle in -100.0..100.0) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!((angle.sin() - wrapped.sin()).abs() < 1e-9 && (angle.cos() - wrapped.cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn half_turns_wrap_to_plus_pi() {
        assert_eq!(wrap_angle(-PI).to_bits(), PI.to_bits());
        assert_eq!(wrap_angle(PI).to_bits(), PI.to_bits());
    }
}
