//! Places of the path that the map hangs on.

use std::sync::Arc;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::View;
use crate::odometry::uncertainty;
use crate::scan::Scan;
use crate::time::Stamp;

/// A scan, and where odometry says it was taken.
#[derive(Clone, Debug)]
pub struct Sighting {
    /// The scan as the laser would have seen it at its stamp: undistorted.
    pub scan: Scan,
    /// Pose of the base where it never jumps, not even when a place is recognised: a step that corrects earlier ones is no motion.
    pub odom_from_base: Pose2,
    /// Covariance of that pose, along the axes of its frame.
    pub covariance: PoseCovariance,
    /// Place of the laser on the base.
    pub base_from_laser: Pose2,
    /// How odometry came to the pose.
    pub passage: Passage,
}

impl Sighting {
    /// Pose of the laser.
    pub fn odom_from_laser(&self) -> Pose2 {
        self.odom_from_base * self.base_from_laser
    }

    /// Covariance of that pose, along the axes of the odometry's frame.
    pub fn laser_covariance(&self) -> PoseCovariance {
        uncertainty::compound(&self.odom_from_base, &self.covariance, &self.base_from_laser, &PoseCovariance::zeros())
    }
}

/// How the robot came from the scan before to this one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passage {
    /// By a motion that is known.
    Known,
    /// In a way that is not known well: the scan could not be matched.
    Lost,
    /// There is none before: odometry has started anew, from wherever.
    Start,
}

/// A place that others are compared with.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// When the scan was taken.
    pub stamp: Stamp,
    /// Pose of the laser by odometry.
    pub odom_from_laser: Pose2,
    /// What was seen; `None`: earlier keyframes have seen it as well, and nothing is compared with this one any more.
    pub view: Option<Arc<View>>,
    /// Number of the run that it is of; odometry says nothing of what is between two.
    pub run: usize,
    /// Way from the first keyframe of all runs to here, m.
    pub way: f64,
}

/// When a place is another one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spacing {
    /// After this way, m, ...
    pub(super) distance: f64,
    /// ... or this turn, rad.
    pub(super) angle: f64,
}

impl Spacing {
    /// Between keyframes: near enough for scans to agree, far enough for errors of matches not to add up.
    pub(super) const KEYFRAMES: Self = Self { distance: 0.4, angle: 0.5 };
    /// Between scans that are drawn: a robot at rest sees nothing new, and what stands about then is not all the more there.
    pub(super) const DRAWN: Self = Self { distance: 0.05, angle: 0.05 };

    /// Whether a motion leads to another place.
    pub(super) fn is_exceeded_by(self, motion: &Pose2) -> bool {
        motion.distance() > self.distance || motion.theta.abs() > self.angle
    }
}
