//! Association of estimated poses with true poses, by their stamps.

use thiserror::Error;

use super::trajectory::Trajectory;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// An estimated pose and the true pose at the same stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedPose {
    /// Stamp of the estimate.
    pub stamp: Stamp,
    /// Estimated pose.
    pub estimate: Pose2,
    /// True pose.
    pub truth: Pose2,
}

/// Two trajectories that hardly overlap in time.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "only {matched} of {poses} poses have a true pose within {max_dt} s (the estimate runs from {} to {} s, the truth from {} to \
     {} s): are both stamped by the same clock, and do both files belong to the same drive?",
    estimate.0, estimate.1, truth.0, truth.1
)]
pub struct AssociationError {
    /// Number of estimated poses with a true pose.
    pub matched: usize,
    /// Number of estimated poses.
    pub poses: usize,
    /// Tolerance in time, s.
    pub max_dt: f64,
    /// First and last stamp of the estimate.
    pub estimate: (Stamp, Stamp),
    /// First and last stamp of the truth.
    pub truth: (Stamp, Stamp),
}

/// The true pose interpolated to a stamp, if there is a true pose within `max_dt` seconds.
pub fn true_pose(truth: &Trajectory, stamp: Stamp, max_dt: f64) -> Option<Pose2> {
    let is_near = truth.nearest(stamp).stamp.seconds_since(stamp).abs() <= max_dt;
    is_near.then(|| truth.interpolated(stamp)).flatten()
}

/// Pairs every estimated pose that has a true pose within `max_dt` seconds with the truth interpolated to its stamp. Without
/// interpolation, a truth of 50 Hz would be off by up to 3 cm at 3 m/s. Fewer than two pairs are an error.
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
