//! Propagation of uncertainty through chains of poses.

use nalgebra::{Matrix3, SymmetricEigen};

use crate::geometry::{Point, Pose2, PoseCovariance};
use crate::scan::Scan;

/// Neighbouring rays within this angle have correlated errors, rad.
const CORRELATION_ANGLE: f64 = 0.08;
/// Constant part of the error of wheel odometry, m and rad: wheels turn on the spot, messages are rounded, stamps jitter.
const WHEEL_ERROR: f64 = 0.01;
/// Within a short time the constant part is smaller, m and rad per root of a second, so that the scan rate makes no difference.
const WHEEL_RANDOM_WALK: f64 = 0.035;

/// Position error of an unknown motion, m.
const UNKNOWN_MOTION_ERROR: f64 = 1.0;
/// Rotation error of an unknown motion, rad.
const UNKNOWN_ROTATION_ERROR: f64 = 0.3;

/// Scale error of uncalibrated wheel odometry: this fraction of the distance. It is the same in every step.
pub(super) const WHEEL_SCALE_ERROR: f64 = 0.1;

/// Covariance of `a * b` in the frame that `a` is given in, for independent errors of the two (Smith, Self and Cheeseman 1990).
/// `a_covariance` is in that frame too, `b_covariance` in the frame that `b` is given in.
pub fn compound(a: &Pose2, a_covariance: &PoseCovariance, b: &Pose2, b_covariance: &PoseCovariance) -> PoseCovariance {
    let jacobian = pose_jacobian(a.transform().rotate(b.translation()));
    jacobian * a_covariance * jacobian.transpose() + rotated(b_covariance, a.theta)
}

/// Jacobian of the pose at `offset` from a pose with respect to the errors of that pose (x, y, heading), all along the same axes.
pub(super) fn pose_jacobian(offset: Point) -> Matrix3<f64> {
    #[rustfmt::skip]
    let jacobian = Matrix3::new(
        1.0, 0.0, -offset.y,
        0.0, 1.0, offset.x,
        0.0, 0.0, 1.0,
    );
    jacobian
}

/// Covariance of a pose after an error-free translation by `offset`, all along the same axes.
pub fn propagated(covariance: &PoseCovariance, offset: Point) -> PoseCovariance {
    let (x, y, rotation) = (offset.x, offset.y, covariance.m33);
    let (with_x, with_y) = (covariance.m13 - y * rotation, covariance.m23 + x * rotation);
    let xx = covariance.m11 - y * (covariance.m13 + with_x);
    let yy = covariance.m22 + x * (covariance.m23 + with_y);
    let xy = covariance.m12 + x * covariance.m13 - y * with_y;
    PoseCovariance::new(xx, xy, with_x, xy, yy, with_y, with_x, with_y, rotation)
}

/// A difference of covariances with its negative eigenvalues set to zero.
pub fn positive_part(difference: &PoseCovariance) -> PoseCovariance {
    let mut eigen = SymmetricEigen::new(*difference);
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    eigen.recompose()
}

/// Rotation matrix for the errors of a pose (x, y, heading).
pub fn rotation(angle: f64) -> Matrix3<f64> {
    let (sin, cos) = angle.sin_cos();
    #[rustfmt::skip]
    let rotation = Matrix3::new(
        cos, -sin, 0.0,
        sin, cos, 0.0,
        0.0, 0.0, 1.0,
    );
    rotation
}

/// A covariance rotated by `angle`, rad.
pub fn rotated(covariance: &PoseCovariance, angle: f64) -> PoseCovariance {
    let rotation = rotation(angle);
    rotation * covariance * rotation.transpose()
}

/// Covariance of a motion measured by wheel odometry within `seconds`, in the frame of its start: grows with distance and
/// rotation. The values suit uncalibrated wheel odometry.
pub fn wheel_covariance(motion: &Pose2, seconds: f64) -> PoseCovariance {
    let (offset, rotation) = (motion.distance(), motion.theta.abs());
    let base = (WHEEL_RANDOM_WALK * seconds.sqrt()).min(WHEEL_ERROR);
    diagonal(base + WHEEL_SCALE_ERROR * offset + 0.02 * rotation, base + 0.15 * rotation + 0.03 * offset)
}

/// Covariance of a motion between two scans about which neither odometry nor a match gives information.
pub fn unknown_motion() -> PoseCovariance {
    diagonal(UNKNOWN_MOTION_ERROR, UNKNOWN_ROTATION_ERROR)
}

/// How many of the rays used in a match count as one measurement: neighbouring rays hit the same object, which may be uneven or
/// have moved (the design effect of Kish 1965).
pub(super) fn correlated_rays(scan: &Scan, rays: u32) -> f64 {
    let angle = scan.beams().angle_increment().abs() * scan.valid_len() as f64;
    (CORRELATION_ANGLE * f64::from(rays) / angle).max(1.0)
}

/// Covariance of independent errors, from standard deviations in x and y, m, and of the heading, rad.
pub fn diagonal(position: f64, heading: f64) -> PoseCovariance {
    PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    #[test]
    fn propagation_can_be_undone() {
        let (start, offset) = (diagonal(0.1, 0.02) + Matrix3::repeat(1e-4), Pose2::new(3.0, -2.0, 0.7));
        let end = compound(&Pose2::IDENTITY, &start, &offset, &PoseCovariance::zeros());
        assert!((propagated(&end, -offset.translation()) - start).norm() < 1e-12);
        assert!((positive_part(&end) - end).norm() < 1e-12 && positive_part(&-end).norm() < 1e-12);
    }

    #[test]
    fn more_rays_in_the_same_angle_add_no_information() {
        for (beams, expected) in [(271_u32, 4.6), (1081, 18.4), (31, 1.0)] {
            let count = beams as usize;
            let geometry = BeamGeometry::new(-2.356, 4.712 / f64::from(beams), count);
            let scan = Scan::new(Stamp::default(), geometry.into(), (0.0, 10.0), vec![1.0; count]).unwrap();
            assert!((correlated_rays(&scan, beams) - expected).abs() < 0.1, "{beams}: {}", correlated_rays(&scan, beams));
            assert!((correlated_rays(&scan, beams / 4) - (expected / 4.0).max(1.0)).abs() < 0.1, "a quarter of them are used");
        }
    }
}
