//! Delay compensation: where the car will be when a command acts, from a pose of some time ago and the commands since.

use std::collections::VecDeque;

use crate::geometry::Pose2;
use crate::simulation::vehicle::{Command, Vehicle, VehicleKnobs};
use crate::time::Stamp;

/// Commands of so long ago are remembered, s: poses that are older are of no use.
const MEMORY: f64 = 3.0;
/// The motion is computed in steps of at most this, s.
const STEP: f64 = 0.005;

/// A car as a bicycle: where it is, how fast, and where its wheels point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Of the rear axle.
    pub pose: Pose2,
    /// Forward, m/s.
    pub speed: f64,
    /// Steering angle, rad.
    pub steering: f64,
}

/// A command from the moment on at which it acts, and the car as it was then by all commands before.
#[derive(Clone, Copy, Debug)]
struct Acting {
    from: Stamp,
    command: Command,
    speed: f64,
    steering: f64,
}

/// The commands given, and what the car does by them.
#[derive(Clone, Debug)]
pub struct CommandHistory {
    car: VehicleKnobs,
    commands: VecDeque<Acting>,
}

impl CommandHistory {
    /// Of a car at rest.
    pub fn new(car: VehicleKnobs) -> Self {
        Self { car, commands: VecDeque::new() }
    }

    /// Nothing is known any more of what was commanded.
    pub fn clear(&mut self) {
        self.commands.clear();
    }

    /// A command that acts from a moment on.
    pub fn record(&mut self, from: Stamp, command: Command) {
        let Motion { speed, steering, .. } = self.carried(Motion::default(), None, from);
        self.commands.push_back(Acting { from, command, speed, steering });
        while self.commands.get(1).is_some_and(|second| from.seconds_since(second.from) > MEMORY) {
            self.commands.pop_front();
        }
    }

    /// Steering angle by the commands at a moment, rad.
    fn steering_at(&self, stamp: Stamp) -> (f64, f64) {
        let Some(last) = self.commands.iter().rev().find(|acting| acting.from <= stamp) else { return (0.0, 0.0) };
        let mut vehicle = Vehicle::moving(&self.car, last.speed, last.steering);
        advance(&mut vehicle, Pose2::IDENTITY, last.command, stamp.seconds_since(last.from));
        (vehicle.speed(), vehicle.turn())
    }

    /// Where the car is at `until` that was at `pose` at `stamp`, there with the measured speed, if there is one.
    pub fn carry(&self, pose: Pose2, stamp: Stamp, speed: Option<f64>, until: Stamp) -> Motion {
        let (commanded, steering) = self.steering_at(stamp);
        self.carried(Motion { pose, speed: speed.unwrap_or(commanded), steering }, Some(stamp), until)
    }

    /// From `stamp`; `None`: from the last command.
    fn carried(&self, start: Motion, stamp: Option<Stamp>, until: Stamp) -> Motion {
        let Some(last) = self.commands.back() else { return start };
        let Some(mut now) = stamp else {
            let mut vehicle = Vehicle::moving(&self.car, last.speed, last.steering);
            let pose = advance(&mut vehicle, start.pose, last.command, until.seconds_since(last.from));
            return Motion { pose, speed: vehicle.speed(), steering: vehicle.turn() };
        };
        let mut vehicle = Vehicle::moving(&self.car, start.speed, start.steering);
        let mut pose = start.pose;
        for (index, acting) in self.commands.iter().enumerate() {
            let end = self.commands.get(index + 1).map_or(until, |next| next.from.min(until));
            if end > now {
                // Before the first command that is remembered the car went on as it was.
                let command = acting.command;
                pose = advance(&mut vehicle, pose, command, end.seconds_since(now));
                now = end;
            }
        }
        Motion { pose, speed: vehicle.speed(), steering: vehicle.turn() }
    }
}

fn advance(vehicle: &mut Vehicle, mut pose: Pose2, command: Command, seconds: f64) -> Pose2 {
    let mut left = seconds.max(0.0);
    while left > 0.0 {
        let step = left.min(STEP);
        pose = pose * vehicle.step(command, step).motion(step);
        left -= step;
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(milliseconds: i64) -> Stamp {
        Stamp::from_nanoseconds(milliseconds * 1_000_000)
    }

    #[test]
    fn a_late_pose_is_carried_to_where_the_car_is() {
        let car = VehicleKnobs { acceleration: 7.5, ..VehicleKnobs::default() };
        let mut history = CommandHistory::new(car.clone());
        let mut vehicle = Vehicle::new(&car);
        let (mut pose, mut poses) = (Pose2::new(1.0, 2.0, 0.3), Vec::new());
        for tick in 0..400 {
            let now = stamp(5 * tick);
            let command = Command { speed: 5.0, curvature: (f64::from(tick as i32) * 0.01).sin() };
            if tick % 4 == 0 {
                history.record(now, command);
            }
            poses.push((now, pose, vehicle.speed()));
            let acting = history.commands.back().unwrap().command;
            pose = pose * vehicle.step(acting, 0.005).motion(0.005);
        }
        for age in [1, 7, 30, 100] {
            let (then, before, speed) = poses[399 - age];
            let (now, truth, _) = poses[399];
            let blind = history.carry(before, then, None, now);
            let told = history.carry(before, then, Some(speed), now);
            for found in [blind, told] {
                let error = truth.between(&found.pose);
                assert!(error.distance() < 1e-9 && error.theta.abs() < 1e-9, "{age}: {error:?}");
            }
        }
    }

    #[test]
    fn without_commands_the_car_is_where_it_was() {
        let history = CommandHistory::new(VehicleKnobs::default());
        assert_eq!(history.carry(Pose2::new(1.0, 0.0, 0.0), stamp(0), None, stamp(100)).pose, Pose2::new(1.0, 0.0, 0.0));
    }
}
