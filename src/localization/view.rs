//! What scans show of the same place: together they are no more evidence than one.

use crate::geometry::Pose2;

/// How far the robot must move for a scan to show something else, and so to err on its own.
pub(super) struct View {
    /// Way, m.
    pub(super) way: f64,
    /// Turn, rad.
    pub(super) turn: f64,
}

impl View {
    /// Evidence of the next scan, in scans, when there were `news` and the robot has moved since. `slack`: way that it may have gone
    /// besides, m.
    pub(super) fn news(&self, news: f64, motion: &Pose2, slack: f64) -> f64 {
        (news + (motion.distance() + slack) / self.way + motion.theta.abs() / self.turn).min(1.0)
    }
}
