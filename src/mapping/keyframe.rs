//! Keyframes: the scans along the path that carry the map.

use std::sync::Arc;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::View;
use crate::odometry::uncertainty;
use crate::scan::Scan;
use crate::time::Stamp;

/// A scan and its pose according to odometry.
#[derive(Clone, Debug)]
pub struct PosedScan {
    /// The scan, corrected for the robot's motion (deskewed): as seen from the laser's pose at its stamp.
    pub scan: Scan,
    /// Pose of the base in the odometry frame. It never jumps, not even at a loop closure, because a correction of earlier poses is no
    /// motion.
    pub odom_from_base: Pose2,
    /// Covariance of that pose, along the axes of the odometry frame.
    pub covariance: PoseCovariance,
    /// Pose of the laser on the base.
    pub base_from_laser: Pose2,
    /// How well the motion since the previous scan is known.
    pub motion_status: MotionStatus,
}

impl PosedScan {
    /// Pose of the laser in the odometry frame.
    pub fn odom_from_laser(&self) -> Pose2 {
        self.odom_from_base * self.base_from_laser
    }

    /// Covariance of the laser's pose, along the axes of the odometry frame.
    pub fn laser_covariance(&self) -> PoseCovariance {
        uncertainty::compound(&self.odom_from_base, &self.covariance, &self.base_from_laser, &PoseCovariance::zeros())
    }
}

/// How well the motion from the previous scan to this one is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionStatus {
    /// The motion is known.
    Known,
    /// The motion is poorly known, because the scan could not be matched.
    Lost,
    /// There is no previous scan: odometry has restarted at an unknown pose, and a new run begins.
    Start,
}

/// A scan that other scans are matched against.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// When the scan was taken.
    pub stamp: Stamp,
    /// Pose of the laser in the odometry frame.
    pub odom_from_laser: Pose2,
    /// The prepared scan. `None` after it was dropped: earlier keyframes cover the same place, and nothing is matched against this one
    /// any more.
    pub view: Option<Arc<View>>,
    /// Number of the run. Odometry gives no motion between two runs.
    pub run: usize,
    /// Length of the path from the very first keyframe to this one, all runs added up, m.
    pub path_length: f64,
}

/// How far the laser must move before the next scan is used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spacing {
    /// Minimum distance, m.
    pub(super) distance: f64,
    /// Minimum rotation, rad; either of the two is enough.
    pub(super) angle: f64,
}

impl Spacing {
    /// Spacing of keyframes: near enough for the scans to overlap, and far enough apart for few match errors to add up.
    pub(super) const KEYFRAMES: Self = Self { distance: 0.4, angle: 0.5 };
    /// Spacing of the scans inserted into the grid. A robot at rest sees nothing new, and people standing around must not gain weight
    /// meanwhile.
    pub(super) const GRID_SCANS: Self = Self { distance: 0.05, angle: 0.05 };

    /// Whether a motion exceeds the spacing.
    pub(super) fn is_exceeded_by(self, motion: &Pose2) -> bool {
        motion.distance() > self.distance || motion.theta.abs() > self.angle
    }
}
