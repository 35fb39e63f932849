//! Which pose of the truth belongs to which pose of the estimate.

use thiserror::Error;

use super::trajectory::Trajectory;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// A pose of the estimate and the true one at the same stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedPose {
    /// When.
    pub stamp: Stamp,
    /// Where the estimate says.
    pub estimate: Pose2,
    /// Where it was.
    pub truth: Pose2,
}

/// Two trajectories that hardly meet in time.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "only {matched} of {poses} poses have a true pose within {max_dt} s (the estimate runs from {} to {} s, the truth from {} to \
     {} s): are both stamped by the same clock, and are the files those of one drive?",
    estimate.0, estimate.1, truth.0, truth.1
)]
pub struct AssociationError {
    /// Poses that have a counterpart.
    pub matched: usize,
    /// Poses of the estimate.
    pub poses: usize,
    /// Tolerance in time, s.
    pub max_dt: f64,
    /// First and last stamp of the estimate.
    pub estimate: (Stamp, Stamp),
    /// First and last stamp of the truth.
    pub truth: (Stamp, Stamp),
}

/// The true pose at a stamp, interpolated, where there is one within `max_dt` seconds.
pub fn true_pose(truth: &Trajectory, stamp: Stamp, max_dt: f64) -> Option<Pose2> {
    let is_near = truth.nearest(stamp).stamp.seconds_since(stamp).abs() <= max_dt;
    is_near.then(|| truth.interpolated(stamp)).flatten()
}

/// Every pose of the estimate that has a pose of the truth within `max_dt` seconds, with the truth interpolated to its own stamp:
/// at 3 m/s a truth of 50 Hz taken as it stands would be off by up to 3 cm. At least two, or an error.
pub fn associate(estimate: &Trajectory, truth: &Trajectory, max_dt: f64) -> Result<Vec<MatchedPose>, AssociationError> {
    let matched: Vec<_> = estimate
        .poses()
        .iter()
        .filter_map(|p| true_pose(truth, p.stamp, max_dt).map(|truth| MatchedPose { stamp: p.stamp, estimate: p.pose, truth }))
        .collect();
    if matched.len() >= 2 {
        return Ok(matched);
    }
    let span = |t: &Trajectory| (t.ends().0.stamp, t.ends().1.stamp);
    Err(AssociationError {
        matched: matched.len(),
        poses: estimate.poses().len(),
        max_dt,
        estimate: span(estimate),
        truth: span(truth),
    })
}
