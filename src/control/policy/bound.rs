//! What delay and error of poses a controller tolerates.

use std::time::Duration;

use super::Situation;
use crate::anytime::mode::Mode;

/// The error of a follower that is told the true pose, m, RMS (docs/driving.md: this one's at 7 m/s).
const TRACKING: f64 = 0.015;
/// Errors this much greater are as good as equal.
const UNNOTICED: f64 = 1.05;
/// So many standard deviations of the car's place are to be within the room beside it.
const SIGMAS: f64 = 3.0;

/// The longest delay from scan to pose. Pure pursuit is a second-order system along the way with the time constant `look-ahead / (2 v)`:
/// a delay of as much makes it unstable, half of it leaves it damped. More than a scan period is never tolerated: scans would be dropped.
pub(super) fn longest_delay(situation: &Situation) -> Duration {
    let speed = situation.speed.abs().max(0.1);
    Duration::from_secs_f64(0.25 * situation.lookahead.max(0.0) / speed).min(situation.period)
}

/// How far from its path a car is to be expected that is steered by poses of this mode, m, RMS. It is steered towards the path one
/// look-ahead away: there an error of the heading counts as one of the position. The heading of a pose is off by how far the car has
/// turned since, too, where its follower does not make up for that. All these errors are independent.
pub(super) fn error_followed(mode: &Mode, situation: &Situation) -> f64 {
    let turned = situation.uncompensated_turn * mode.delay.as_secs_f64();
    TRACKING.hypot(mode.error.translation).hypot(situation.lookahead * mode.error.rotation.hypot(turned))
}

/// The greatest such error, where `least` is the least to be had.
pub(super) fn greatest_error(least: f64, situation: &Situation) -> f64 {
    (UNNOTICED * least).min(situation.clearance.max(0.0) / SIGMAS)
}
