//! A predicted motion with its covariance.

use super::uncertainty;
use crate::geometry::{Pose2, PoseCovariance};

/// A predicted motion of the base, in the frame of its start.
#[derive(Clone, Copy)]
pub(super) struct Prediction {
    /// The motion.
    pub(super) motion: Pose2,
    /// Its covariance.
    pub(super) covariance: PoseCovariance,
}

impl Prediction {
    /// No motion, without uncertainty.
    pub(super) const NO_MOTION: Self =
        Self { motion: Pose2::IDENTITY, covariance: PoseCovariance::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) };

    /// A motion measured by wheel odometry within `seconds`.
    pub(super) fn by_wheels(motion: Pose2, seconds: f64) -> Self {
        Self { motion, covariance: uncertainty::wheel_covariance(&motion, seconds) }
    }

    /// Fuses two predictions of the same motion with independent errors (the Kalman filter's update).
    pub(super) fn fused_with(&self, other: &Self) -> Self {
        let sum = self.covariance + other.covariance;
        let Some(information) = sum.try_inverse() else { return *self };
        let gain = self.covariance * information;
        let (a, b) = (self.motion, other.motion);
        let change = gain * a.difference(&b);
        let motion = Pose2::new(a.x + change.x, a.y + change.y, a.theta + change.z);
        Self { motion, covariance: self.covariance - gain * self.covariance }
    }
}
