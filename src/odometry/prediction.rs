//! A motion that is expected, with its covariance.

use crate::geometry::{Pose2, PoseCovariance};

/// A motion of the base that is expected, seen from its start.
#[derive(Clone, Copy)]
pub(super) struct Prediction {
    /// The motion.
    pub(super) motion: Pose2,
    /// Its covariance.
    pub(super) covariance: PoseCovariance,
}

impl Prediction {
    /// None.
    pub(super) const NONE: Self =
        Self { motion: Pose2::IDENTITY, covariance: PoseCovariance::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) };

    /// What is known when another source says something of the same motion, with errors of its own (the Kalman filter's update).
    pub(super) fn and(&self, other: &Self) -> Self {
        let sum = self.covariance + other.covariance;
        let Some(information) = sum.try_inverse() else { return *self };
        let gain = self.covariance * information;
        let (a, b) = (self.motion, other.motion);
        let change = gain * a.difference(&b);
        let motion = Pose2::new(a.x + change.x, a.y + change.y, a.theta + change.z);
        Self { motion, covariance: self.covariance - gain * self.covariance }
    }
}
