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
    let (sin, cos) = a.theta.sin_cos();
    #[rustfmt::skip]
    let by_b = Matrix3::new(
        cos, -sin, 0.0,
        sin, cos, 0.0,
        0.0, 0.0, 1.0,
    );
    by_a * a_covariance * by_a.transpose() + by_b * b_covariance * by_b.transpose()
}

/// Covariance of a predicted motion, seen from its start: grows with the way and the turn. The figures suit uncalibrated wheel
/// odometry.
pub fn of_prediction(motion: &Pose2) -> PoseCovariance {
    let (way, turn) = (motion.distance(), motion.theta.abs());
    let position = 0.01 + 0.1 * way + 0.02 * turn;
    let heading = 0.01 + 0.15 * turn + 0.03 * way;
    PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into())
}
