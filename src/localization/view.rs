//! How much new evidence a scan carries: scans from the same pose are together no more evidence than one.

use crate::geometry::Pose2;

/// Motion after which a scan shows something new, so that its errors are independent of the previous ones.
pub(super) struct View {
    /// Distance, m.
    pub(super) distance: f64,
    /// Rotation, rad.
    pub(super) rotation: f64,
}

impl View {
    /// Evidence of the next scan, as a fraction of an independent scan: the unused `novelty`, and that of the motion since.
    /// `slack`: distance that the robot may have moved in addition, m.
    pub(super) fn novelty(&self, novelty: f64, motion: &Pose2, slack: f64) -> f64 {
        (novelty + (motion.distance() + slack) / self.distance + motion.theta.abs() / self.rotation).min(1.0)
    }
}
