//! What delay and error of poses a controller tolerates.

use std::time::Duration;

use super::Situation;

/// An error of the pose of this part of the controller's own adds 5 % to their sum, as they are independent (1.05^2 = 1 + 0.32^2).
const UNNOTICED: f64 = 0.32;
/// The error of pure pursuit by itself on a racecar, m: what the best published controllers reach.
const TRACKING: f64 = 0.055;
/// Three standard deviations of all errors are to be within the room beside the car.
const SIGMAS: f64 = 3.0;

/// Limits of a pose's delay and error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerBound {
    /// From the scan to the pose.
    pub delay: Duration,
    /// One standard deviation, m.
    pub error: f64,
}

impl ControllerBound {
    /// In a situation. Pure pursuit is a second-order system along the way with the time constant `look-ahead / (2 v)`: a delay of as much
    /// makes it unstable, half of it leaves it damped. More than a scan period is never tolerated: poses would be dropped.
    pub fn of(situation: &Situation) -> Self {
        let speed = situation.speed.abs().max(0.1);
        let delay = Duration::from_secs_f64(0.25 * situation.lookahead.max(0.0) / speed).min(situation.period);
        Self { delay, error: (UNNOTICED * TRACKING).min(situation.clearance.max(0.0) / SIGMAS / SIGMAS) }
    }
}
