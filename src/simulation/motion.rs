//! The true motion of a whole drive: the pose of the car at any time.

use crate::geometry::{Pose2, Twist2};

use super::driver::Driver;
use super::route::Route;
use super::vehicle::{Command, Vehicle, VehicleKnobs};

/// Period of the driver's commands, s; in between the car moves on an arc of constant curvature.
pub(super) const TICK: f64 = 0.005;
/// Time at rest before the car starts, s.
const REST_TIME: f64 = 1.0;

/// The motion of the car during a drive.
#[derive(Clone, Debug)]
pub struct Motion {
    ticks: Vec<(Pose2, Twist2)>,
}

impl Motion {
    /// Simulates laps of `route` for `seconds`.
    pub fn drive(route: &Route, knobs: &VehicleKnobs, seconds: f64) -> Self {
        let mut driver = Driver::new(route, knobs);
        let mut vehicle = Vehicle::new(knobs);
        let mut pose = driver.start();
        let mut ticks = Vec::new();
        while ticks.len() as f64 * TICK <= seconds {
            let resting = (ticks.len() as f64) * TICK < REST_TIME;
            let command = if resting { Command::default() } else { driver.command(&pose, vehicle.speed()) };
            let twist = vehicle.step(command, TICK);
            ticks.push((pose, twist));
            pose = pose * twist.motion(TICK);
        }
        Self { ticks }
    }

    /// The pose of `base_link` at each [`TICK`].
    pub(super) fn ticks(&self) -> impl Iterator<Item = Pose2> + '_ {
        self.ticks.iter().map(|(pose, _)| *pose)
    }

    /// The pose of `base_link` (`map_from_base`) `seconds` after the start.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped to the drive
    pub fn pose_at(&self, seconds: f64) -> Pose2 {
        let tick = ((seconds / TICK) as usize).min(self.ticks.len() - 1);
        let (pose, twist) = self.ticks[tick];
        pose * twist.motion(seconds - tick as f64 * TICK)
    }
}
