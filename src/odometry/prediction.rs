//! A motion that is expected, with its covariance.

use nalgebra::Vector3;

use crate::geometry::{Pose2, PoseCovariance, wrap_angle};

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
        let change = gain * Vector3::new(b.x - a.x, b.y - a.y, wrap_angle(b.theta - a.theta));
        let motion = Pose2::new(a.x + change.x, a.y + change.y, wrap_angle(a.theta + change.z));
        Self { motion, covariance: self.covariance - gain * self.covariance }
    }
}
