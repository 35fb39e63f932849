//! How uncertainty goes through chains of poses.

use nalgebra::Matrix3;

use crate::geometry::{Point, Pose2, PoseCovariance};

/// Covariance of `a * b` in the frame that `a` is given in, for independent errors of the two (Smith, Self and Cheeseman 1990).
/// `a_covariance` is in that frame too, `b_covariance` in the frame that `b` is given in.
pub fn compound(a: &Pose2, a_covariance: &PoseCovariance, b: &Pose2, b_covariance: &PoseCovariance) -> PoseCovariance {
    let by_a = way_by_heading(a.transform().rotate(b.translation()));
    by_a * a_covariance * by_a.transpose() + turned(b_covariance, a.theta)
}

/// How errors of a pose (x, y, heading) change where a way from there ends, which is `way` long, all along the same axes.
pub(super) fn way_by_heading(way: Point) -> Matrix3<f64> {
    #[rustfmt::skip]
    let by_pose = Matrix3::new(
        1.0, 0.0, -way.y,
        0.0, 1.0, way.x,
        0.0, 0.0, 1.0,
    );
    by_pose
}

/// A turn of the axes that errors (x, y, heading) are given along.
pub(super) fn turn(angle: f64) -> Matrix3<f64> {
    let (sin, cos) = angle.sin_cos();
    #[rustfmt::skip]
    let turn = Matrix3::new(
        cos, -sin, 0.0,
        sin, cos, 0.0,
        0.0, 0.0, 1.0,
    );
    turn
}

/// A covariance along other axes: those that it is given along lie at `angle` in the new ones, rad.
pub fn turned(covariance: &PoseCovariance, angle: f64) -> PoseCovariance {
    let turn = turn(angle);
    turn * covariance * turn.transpose()
}

/// Covariance of a motion measured by wheels, seen from its start: grows with the way and the turn. The figures suit uncalibrated
/// wheel odometry.
pub fn of_wheels(motion: &Pose2) -> PoseCovariance {
    let (way, turn) = (motion.distance(), motion.theta.abs());
    diagonal(0.01 + 0.1 * way + 0.02 * turn, 0.01 + 0.15 * turn + 0.03 * way)
}

/// Covariance of independent errors: standard deviations in x and y, m, and of the heading, rad.
pub fn diagonal(position: f64, heading: f64) -> PoseCovariance {
    PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into())
}
