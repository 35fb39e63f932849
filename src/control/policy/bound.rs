//! The delay and error of poses that a controller tolerates.

use std::time::Duration;

use super::Situation;
use crate::anytime::mode::Mode;

/// RMS tracking error of the follower with true poses, m (at 7 m/s, see docs/driving.md).
const TRACKING_ERROR: f64 = 0.015;
/// Errors that differ by less than this factor count as equal.
const EQUAL_ERROR_RATIO: f64 = 1.05;
/// The clearance must be at least this many standard deviations of the car's position.
const SIGMAS: f64 = 3.0;

/// Maximum delay from scan to pose. Pure pursuit is a second-order system with the time constant `lookahead / (2 v)`: a delay of
/// that size makes it unstable, half of it leaves it damped. The delay is never more than a scan period, since scans would be
/// dropped.
pub(super) fn max_delay(situation: &Situation) -> Duration {
    let speed = situation.speed.abs().max(0.1);
    Duration::from_secs_f64(0.25 * situation.lookahead.max(0.0) / speed).min(situation.period)
}

/// Expected RMS tracking error of a car that is steered by poses of this mode, m. The car steers towards the path at the
/// lookahead distance, where a heading error acts as a position error. Without delay compensation the rotation of the car during
/// the delay adds to the heading error. All errors are taken as independent.
pub(super) fn expected_tracking_error(mode: &Mode, situation: &Situation) -> f64 {
    let rotation = situation.uncompensated_yaw_rate * mode.delay.as_secs_f64();
    TRACKING_ERROR.hypot(mode.error.translation).hypot(situation.lookahead * mode.error.rotation.hypot(rotation))
}

/// Maximum acceptable tracking error, m, if `min_error` is the smallest achievable one.
pub(super) fn max_error(min_error: f64, situation: &Situation) -> f64 {
    (EQUAL_ERROR_RATIO * min_error).min(situation.clearance.max(0.0) / SIGMAS)
}
