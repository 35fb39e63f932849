//! The modes of a table: what error to expect of a time budget, on this course and this machine.

use std::time::Duration;

use super::DriveError;
use super::closed_loop::{Setup, drive};
use super::processor::Load;
use crate::anytime::contract::Contract;
use crate::control::policy::{Mode, Policy};

/// Time budgets as parts of the scan period.
const PARTS: [f64; 7] = [0.025, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0];
/// Speed of the drive that is profiled, m/s: one at which no budget loses the car.
const SPEED: f64 = 2.0;

/// The modes of a setup's estimator, by their delay: one lap at moderate speed for each, on the machine without bursts.
pub(super) fn modes(setup: &Setup) -> Result<Vec<Mode>, DriveError> {
    let mode = |part: f64| {
        let delay = Duration::from_secs_f64(part / setup.lidar.rate);
        let contract = Contract { time_budget: Some(delay), ..Contract::default() };
        let mut profiled =
            Setup { policy: Policy::Fixed(contract), laps: 1, load: Load { bursts: 1.0, ..setup.load }, ..setup.clone() };
        profiled.follower.speed = SPEED.min(setup.follower.speed);
        drive(&profiled).map(|run| Mode { delay, error: run.pose_error() })
    };
    crate::parallel::map(PARTS.into_iter(), mode).into_iter().collect()
}
