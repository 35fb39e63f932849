//! How uncertainty goes through chains of poses.

use nalgebra::{Matrix3, SymmetricEigen};

use crate::geometry::{Point, Pose2, PoseCovariance};
use crate::scan::Scan;

/// Neighbouring rays within this angle err alike, rad.
const ERRING_ALIKE: f64 = 0.08;
/// What wheels say is off by so much, m and rad, whatever the robot does: they turn on the spot, messages are rounded, stamps jitter ...
const WHEEL_ERROR: f64 = 0.01;
/// ... and within a short time by less, m and rad per root of a second, so that a laser's rate makes no difference.
const WHEEL_WANDERING: f64 = 0.035;

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

/// Covariance of a pose that is carried `way` farther, by a motion without error; all along the same axes.
pub fn carried(covariance: &PoseCovariance, way: Point) -> PoseCovariance {
    let (x, y, turn) = (way.x, way.y, covariance.m33);
    let (with_x, with_y) = (covariance.m13 - y * turn, covariance.m23 + x * turn);
    let xx = covariance.m11 - y * (covariance.m13 + with_x);
    let yy = covariance.m22 + x * (covariance.m23 + with_y);
    let xy = covariance.m12 + x * covariance.m13 - y * with_y;
    PoseCovariance::new(xx, xy, with_x, xy, yy, with_y, with_x, with_y, turn)
}

/// A difference of covariances, without what is negative of it.
pub fn positive(difference: &PoseCovariance) -> PoseCovariance {
    let mut parts = SymmetricEigen::new(*difference);
    parts.eigenvalues.apply(|part| *part = part.max(0.0));
    parts.recompose()
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

/// Covariance of a motion measured by wheels within `seconds`, seen from its start: grows with the way and the turn. The figures suit
/// uncalibrated wheel odometry.
pub fn of_wheels(motion: &Pose2, seconds: f64) -> PoseCovariance {
    let (way, turn) = (motion.distance(), motion.theta.abs());
    let still = (WHEEL_WANDERING * seconds.sqrt()).min(WHEEL_ERROR);
    diagonal(still + 0.1 * way + 0.02 * turn, still + 0.15 * turn + 0.03 * way)
}

/// How many of the rays of a scan that have taken part in a match are as good as one in saying where something stands: they have met the
/// same thing, which may be uneven or have moved since (the design effect of Kish 1965).
pub(super) fn rays_alike(scan: &Scan, rays: u32) -> f64 {
    let angle = scan.beams().angle_increment().abs() * scan.valid_len() as f64;
    (ERRING_ALIKE * f64::from(rays) / angle).max(1.0)
}

/// Covariance of independent errors: standard deviations in x and y, m, and of the heading, rad.
pub fn diagonal(position: f64, heading: f64) -> PoseCovariance {
    PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    #[test]
    fn what_a_way_adds_is_taken_back() {
        let (start, way) = (diagonal(0.1, 0.02) + Matrix3::repeat(1e-4), Pose2::new(3.0, -2.0, 0.7));
        let end = compound(&Pose2::IDENTITY, &start, &way, &PoseCovariance::zeros());
        assert!((carried(&end, -way.translation()) - start).norm() < 1e-12);
        assert!((positive(&end) - end).norm() < 1e-12 && positive(&-end).norm() < 1e-12);
    }

    #[test]
    fn more_rays_into_the_same_angle_know_no_more() {
        for (beams, expected) in [(271_u32, 4.6), (1081, 18.4), (31, 1.0)] {
            let count = beams as usize;
            let geometry = BeamGeometry::new(-2.356, 4.712 / f64::from(beams), count);
            let scan = Scan::new(Stamp::default(), geometry.into(), (0.0, 10.0), vec![1.0; count]).unwrap();
            assert!((rays_alike(&scan, beams) - expected).abs() < 0.1, "{beams}: {}", rays_alike(&scan, beams));
            assert!((rays_alike(&scan, beams / 4) - (expected / 4.0).max(1.0)).abs() < 0.1, "a quarter of them take part");
        }
    }
}
