//! Where and when a scan was taken.

use crate::geometry::{Pose2, PoseCovariance};
use crate::time::Stamp;

/// Where and when a scan was taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    /// When.
    pub(super) stamp: Stamp,
    /// Pose of the laser.
    pub(super) map_from_laser: Pose2,
    /// Its place on the base.
    pub(super) base_from_laser: Pose2,
    /// Covariance of that pose, in the map frame.
    pub(super) covariance: PoseCovariance,
    /// What the last step of the way there adds to it.
    pub(super) step_covariance: PoseCovariance,
}

impl Placement {
    /// The laser's heading, seen from another's.
    pub(super) fn heading_from(&self, map_from_laser: &Pose2) -> f64 {
        self.map_from_laser.theta - map_from_laser.theta
    }

    /// Pose of the base.
    pub(super) fn map_from_base(&self) -> Pose2 {
        self.map_from_laser * self.base_from_laser.inverse()
    }
}
