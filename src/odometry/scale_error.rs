//! The share of the pose error that is due to the unknown scale of the odometry.
//!
//! A wheel radius that is off by 5 % makes every step too long or too short by 5 %, so that these errors add up in proportion to the
//! distance wherever matches do not constrain the motion along it, as in a corridor. Independent errors would add up with its
//! square root. The scale is not estimated but considered: a Schmidt-Kalman filter (S. F. Schmidt, "Application of state-space methods to
//! navigation problems", 1966), which needs only the derivative of the pose by the scale.

use nalgebra::{Matrix3, Vector3};

use super::uncertainty::{WHEEL_SCALE_ERROR, pose_jacobian};
use crate::geometry::{Point, Pose2, PoseCovariance};

/// Derivative of a pose on the map (m, m, rad) by the relative scale error of the odometry.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScaleJacobian(Vector3<f64>);

impl ScaleJacobian {
    pub(super) const NONE: Self = Self(Vector3::new(0.0, 0.0, 0.0));

    /// That of a pose rigidly attached at `offset`, along the axes of the map.
    pub(super) fn at(self, offset: Point) -> Self {
        Self(pose_jacobian(offset) * self.0)
    }

    /// After a motion measured by odometry, from a pose with this heading.
    pub(super) fn after(self, motion: &Pose2, heading: f64) -> Self {
        let offset = Pose2::new(0.0, 0.0, heading).transform().rotate(motion.translation());
        Self(self.at(offset).0 + Vector3::new(offset.x, offset.y, 0.0))
    }

    /// Of a match relative to a keyframe, which leaves the fraction `prior_weight` of the `predicted` pose.
    pub(super) fn fused(keyframe: Self, predicted: Self, prior_weight: &Matrix3<f64>) -> Self {
        Self(keyframe.0 + prior_weight * (predicted.0 - keyframe.0))
    }

    /// Covariance of the pose by the scale error.
    pub(super) fn covariance(self) -> PoseCovariance {
        WHEEL_SCALE_ERROR * WHEEL_SCALE_ERROR * self.0 * self.0.transpose()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    /// Standard deviation of the position after 100 steps of 0.1 m to the north, of which matches leave the fraction `left`.
    fn deviation_after(left: &Matrix3<f64>) -> f64 {
        let keyframe = ScaleJacobian::NONE;
        let step = |pose: ScaleJacobian| ScaleJacobian::fused(keyframe, pose.after(&Pose2::new(0.1, 0.0, 0.0), FRAC_PI_2), left);
        let pose = (0..100).fold(ScaleJacobian::NONE, |pose, _| step(pose));
        assert!(pose.covariance().m11 < 1e-12, "nothing to the side");
        pose.covariance().m22.sqrt()
    }

    #[test]
    fn the_error_grows_with_the_distance_if_matches_leave_it_open() {
        assert!((deviation_after(&Matrix3::identity()) - 10.0 * WHEEL_SCALE_ERROR).abs() < 1e-9);
        assert!(deviation_after(&Matrix3::zeros()) < 1e-12);
        // Where the match is as good as the prediction, half of it remains in each step: 0.1 m in the sum.
        assert!((deviation_after(&(0.5 * Matrix3::identity())) - 0.1 * WHEEL_SCALE_ERROR).abs() < 1e-6);
    }

    #[test]
    fn a_heading_error_moves_what_is_far_away() {
        let turned = ScaleJacobian(Vector3::new(0.0, 0.0, 1.0)).at(Point::new(3.0, 0.0));
        assert_eq!(turned.0, Vector3::new(0.0, 3.0, 1.0));
    }
}
