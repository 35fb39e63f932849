//! A whole drive: where the car is at every moment.

use crate::geometry::{Pose2, Twist2};

use super::driver::Driver;
use super::route::Route;
use super::vehicle::{Command, Vehicle, VehicleKnobs};

/// The driver thinks this often, s; in between the car goes on in an arc of constant curvature.
pub(super) const TICK: f64 = 0.005;
/// Time at rest before the car sets off, s.
const REST: f64 = 1.0;

/// Poses of a drive, at any time within it.
#[derive(Clone, Debug)]
pub struct Motion {
    ticks: Vec<(Pose2, Twist2)>,
}

impl Motion {
    /// Drives along `route`, lap after lap, for `seconds`.
    pub fn drive(route: &Route, knobs: &VehicleKnobs, seconds: f64) -> Self {
        let mut driver = Driver::new(route, knobs);
        let mut vehicle = Vehicle::new(knobs);
        let mut pose = driver.start();
        let mut ticks = Vec::new();
        while ticks.len() as f64 * TICK <= seconds {
            let resting = (ticks.len() as f64) * TICK < REST;
            let command = if resting { Command::default() } else { driver.command(&pose, vehicle.speed()) };
            let twist = vehicle.step(command, TICK);
            ticks.push((pose, twist));
            pose = pose * twist.motion(TICK);
        }
        Self { ticks }
    }

    /// Where `base_link` is at each [`TICK`].
    pub(super) fn ticks(&self) -> impl Iterator<Item = Pose2> + '_ {
        self.ticks.iter().map(|(pose, _)| *pose)
    }

    /// Where `base_link` is, `seconds` after the start: `map_from_base`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped to the drive
    pub fn pose_at(&self, seconds: f64) -> Pose2 {
        let tick = ((seconds / TICK) as usize).min(self.ticks.len() - 1);
        let (pose, twist) = self.ticks[tick];
        pose * twist.motion(seconds - tick as f64 * TICK)
    }
}
