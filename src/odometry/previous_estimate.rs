//! The estimate of the previous scan, from which the next one is predicted.

use super::motion_state::MotionState;
use super::scale_error::ScaleJacobian;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::time::Stamp;

/// Maximum deviation from the position at constant velocity that is not a jump, m, besides acceleration.
const MAX_POSITION_JUMP: f64 = 0.04;
/// Maximum deviation from the heading at constant angular velocity that is not a jump, rad, besides acceleration.
const MAX_HEADING_JUMP: f64 = 0.04;
/// Maximum linear acceleration of a robot, m/s^2.
const MAX_ACCELERATION: f64 = 30.0;
/// Maximum angular acceleration of a robot, rad/s^2.
const MAX_ANGULAR_ACCELERATION: f64 = 100.0;

/// The estimate of the previous scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct PreviousEstimate {
    pub(super) stamp: Stamp,
    pub(super) map_from_base: Pose2,
    pub(super) map_from_laser: Pose2,
    pub(super) covariance: PoseCovariance,
    /// How the scale error of the odometry, which is not in that covariance, moves the base.
    pub(super) by_scale: ScaleJacobian,
    /// Covariance relative to the keyframe it was matched to, along the axes of the base.
    pub(super) covariance_to_keyframe: PoseCovariance,
    /// Velocity from the estimate before to this one.
    pub(super) measured_twist: Twist2,
    /// The latest measured velocity that a robot can have driven. It is used to deskew scans: the filtered velocity, which is
    /// that at the end of the step, overshoots, and a scan deskewed by too much would make it overshoot again.
    pub(super) mean_twist: Twist2,
    /// Filtered velocity and its uncertainty.
    pub(super) motion: MotionState,
    /// A later scan could not be matched and was skipped: the next scan still starts from this estimate.
    pub(super) has_skipped_scan: bool,
}

impl PreviousEstimate {
    /// An estimate of which no more is known than this.
    pub(super) fn new(stamp: Stamp, map_from_base: Pose2, covariance: PoseCovariance, motion: &MotionState) -> Self {
        Self {
            stamp,
            map_from_base,
            map_from_laser: map_from_base,
            covariance,
            by_scale: ScaleJacobian::NONE,
            covariance_to_keyframe: PoseCovariance::zeros(),
            measured_twist: motion.twist,
            mean_twist: motion.twist,
            motion: *motion,
            has_skipped_scan: false,
        }
    }

    /// Covariance of the base on the map, by all errors.
    pub(super) fn total_covariance(&self) -> PoseCovariance {
        self.covariance + self.by_scale.covariance()
    }

    /// Mounting pose of the laser that took the scan.
    pub(super) fn base_from_laser(&self) -> Pose2 {
        self.map_from_base.between(&self.map_from_laser)
    }

    /// Whether the robot can have changed its velocity to this one within `seconds`. If it continues at the velocity measured last,
    /// the assumed velocity was wrong.
    pub(super) fn can_reach(&self, twist: &Twist2, seconds: f64) -> bool {
        [self.motion.twist, self.measured_twist].iter().any(|before| is_reachable(before, twist, seconds))
    }
}

/// Whether a robot can change from one velocity to the other within `seconds`.
fn is_reachable(before: &Twist2, after: &Twist2, seconds: f64) -> bool {
    let change = (after.vx - before.vx).hypot(after.vy - before.vy);
    let heading_rate_change = (after.omega - before.omega).abs();
    let within = |change: f64, jump: f64, acceleration: f64| change * seconds < jump + acceleration * seconds * seconds;
    within(change, MAX_POSITION_JUMP, MAX_ACCELERATION) && within(heading_rate_change, MAX_HEADING_JUMP, MAX_ANGULAR_ACCELERATION)
}
