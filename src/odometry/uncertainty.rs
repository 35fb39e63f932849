//! How uncertainty goes through chains of poses.

use nalgebra::Matrix3;

use crate::geometry::{Pose2, PoseCovariance};

/// Covariance of `a * b` in the frame that `a` is given in, for independent errors of the two (Smith, Self and Cheeseman 1990).
/// `a_covariance` is in that frame too, `b_covariance` in the frame that `b` is given in.
pub fn compound(a: &Pose2, a_covariance: &PoseCovariance, b: &Pose2, b_covariance: &PoseCovariance) -> PoseCovariance {
    let lever = a.transform().rotate(b.translation());
    #[rustfmt::skip]
    let by_a = Matrix3::new(
        1.0, 0.0, -lever.y,
        0.0, 1.0, lever.x,
        0.0, 0.0, 1.0,
    );
    by_a * a_covariance * by_a.transpose() + turned(b_covariance, a.theta)
}

/// A covariance along other axes: those that it is given along lie at `angle` in the new ones, rad.
pub fn turned(covariance: &PoseCovariance, angle: f64) -> PoseCovariance {
    let (sin, cos) = angle.sin_cos();
    #[rustfmt::skip]
    let turn = Matrix3::new(
        cos, -sin, 0.0,
        sin, cos, 0.0,
        0.0, 0.0, 1.0,
    );
    turn * covariance * turn.transpose()
}

/// Covariance of a motion measured by wheels, seen from its start: grows with the way and the turn. The figures suit uncalibrated
/// wheel odometry.
pub fn of_wheels(motion: &Pose2) -> PoseCovariance {
    let (way, turn) = (motion.distance(), motion.theta.abs());
    diagonal(0.01 + 0.1 * way + 0.02 * turn, 0.01 + 0.15 * turn + 0.03 * way)
}

/// Covariance of a motion at constant velocity: a robot may have sped up by some 5 m/s^2 and 20 rad/s^2.
pub fn of_constant_velocity(seconds: f64) -> PoseCovariance {
    let half_square = 0.5 * seconds * seconds;
    diagonal(0.01 + 5.0 * half_square, 0.01 + 20.0 * half_square)
}

/// Covariance of independent errors: standard deviations in x and y, m, and of the heading, rad.
pub fn diagonal(position: f64, heading: f64) -> PoseCovariance {
    PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into())
}
