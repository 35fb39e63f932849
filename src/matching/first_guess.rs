//! What a match starts from: the first guess, prior knowledge of the pose, and the window of the search.

use crate::geometry::{Pose2, PoseCovariance};

/// Prior knowledge of a pose from other sources, such as odometry.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Pose of the sensed laser in the reference frame.
    pub pose: Pose2,
    /// Its covariance, m, m, rad.
    pub covariance: PoseCovariance,
}

impl Prior {
    /// Mahalanobis distance of a pose from the prior, in standard deviations (Mahalanobis 1936).
    pub(crate) fn mahalanobis_distance(&self, pose: &Pose2) -> f64 {
        let offset = self.pose.difference(pose);
        self.covariance.try_inverse().map_or(0.0, |information| offset.dot(&(information * offset)).sqrt())
    }
}

/// Initial guess of a match.
#[derive(Clone, Copy, Debug)]
pub struct FirstGuess {
    /// Pose of the sensed laser in the reference frame.
    pub pose: Pose2,
    /// Prior that is weighed against the scans, if any.
    pub prior: Option<Prior>,
    /// Window of the search for other solutions.
    pub window: SearchWindow,
}

/// Window around the first guess in which other starts are tried if tracking from the first guess fits badly.
#[derive(Clone, Copy, Debug)]
pub struct SearchWindow {
    /// Half width of the window in x and y, m.
    pub distance: f64,
    /// Half width of the window in heading, rad.
    pub angle: f64,
    /// Search if a smaller fraction of the rays agrees; more than 1: always search.
    pub min_agreement: f64,
}

impl Default for SearchWindow {
    /// Twice the error that tracking alone can correct.
    fn default() -> Self {
        Self { distance: 0.3, angle: 0.35, min_agreement: 0.9 }
    }
}

/// A first guess without a prior.
impl From<Pose2> for FirstGuess {
    fn from(pose: Pose2) -> Self {
        Self { pose, prior: None, window: SearchWindow::default() }
    }
}
