//! The pose of a keyframe, and how well it is known.

use super::scale_error::ScaleJacobian;
use crate::geometry::{Pose2, PoseCovariance};

/// The pose of a keyframe, and how well it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct KeyframePose {
    /// Pose of the laser on the map.
    pub(super) map_from_laser: Pose2,
    /// Mounting pose of the laser.
    pub(super) base_from_laser: Pose2,
    /// Covariance of the laser's pose, in the map frame.
    pub(super) covariance: PoseCovariance,
    /// How the scale error of the odometry, which is not in that covariance, moves the laser.
    pub(super) by_scale: ScaleJacobian,
    /// The part of that covariance that the last step of the path added.
    pub(super) step_covariance: PoseCovariance,
}

impl KeyframePose {
    /// The laser's heading relative to that of another pose, rad.
    pub(super) fn heading_from(&self, map_from_laser: &Pose2) -> f64 {
        self.map_from_laser.theta - map_from_laser.theta
    }

    /// Pose of the base on the map.
    pub(super) fn map_from_base(&self) -> Pose2 {
        self.map_from_laser * self.base_from_laser.inverse()
    }
}
