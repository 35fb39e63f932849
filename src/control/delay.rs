//! Delay compensation: predicts where the car will be when a command takes effect, from an older pose and the commands given
//! since.

use std::collections::VecDeque;

use crate::geometry::Pose2;
use crate::simulation::vehicle::{Command, Vehicle, VehicleKnobs};
use crate::time::Stamp;

/// Duration of the command history, s: older poses are not used.
const HISTORY_DURATION: f64 = 3.0;
/// Maximum integration step, s.
const MAX_STEP: f64 = 0.005;

/// State of the kinematic bicycle model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VehicleState {
    /// Pose of the rear axle.
    pub pose: Pose2,
    /// Forward speed, m/s.
    pub speed: f64,
    /// Steering angle, rad.
    pub steering: f64,
}

/// A command, the time at which it takes effect, and the predicted speed and steering angle at that time.
#[derive(Clone, Copy, Debug)]
struct TimedCommand {
    from: Stamp,
    command: Command,
    speed: f64,
    steering: f64,
}

/// The commands given, and the vehicle model to predict their effect.
#[derive(Clone, Debug)]
pub struct CommandHistory {
    car: VehicleKnobs,
    commands: VecDeque<TimedCommand>,
}

impl CommandHistory {
    /// An empty history, for a car at rest.
    pub fn new(car: VehicleKnobs) -> Self {
        Self { car, commands: VecDeque::new() }
    }

    /// Forgets all commands.
    pub fn clear(&mut self) {
        self.commands.clear();
    }

    /// Records a command that takes effect at `from`.
    pub fn record(&mut self, from: Stamp, command: Command) {
        let VehicleState { speed, steering, .. } = self.integrate(VehicleState::default(), None, from);
        self.commands.push_back(TimedCommand { from, command, speed, steering });
        while self.commands.get(1).is_some_and(|second| from.seconds_since(second.from) > HISTORY_DURATION) {
            self.commands.pop_front();
        }
    }

    /// Speed, m/s, and steering angle, rad, at a time, predicted from the commands.
    fn commanded_at(&self, stamp: Stamp) -> (f64, f64) {
        let Some(last) = self.commands.iter().rev().find(|timed| timed.from <= stamp) else { return (0.0, 0.0) };
        let mut vehicle = Vehicle::moving(&self.car, last.speed, last.steering);
        advance(&mut vehicle, Pose2::IDENTITY, last.command, stamp.seconds_since(last.from));
        (vehicle.speed(), vehicle.steering_state())
    }

    /// Predicts the state at `until` of a car that was at `pose` at `stamp`, with the measured speed at that time if there is
    /// one.
    pub fn predict(&self, pose: Pose2, stamp: Stamp, speed: Option<f64>, until: Stamp) -> VehicleState {
        let (commanded, steering) = self.commanded_at(stamp);
        self.integrate(VehicleState { pose, speed: speed.unwrap_or(commanded), steering }, Some(stamp), until)
    }

    /// Integrates the commands from `start` at `stamp` to `until`. Without a stamp only the last command is integrated, from the
    /// speed and the steering angle recorded with it.
    fn integrate(&self, start: VehicleState, stamp: Option<Stamp>, until: Stamp) -> VehicleState {
        let Some(last) = self.commands.back() else { return start };
        let Some(mut now) = stamp else {
            let mut vehicle = Vehicle::moving(&self.car, last.speed, last.steering);
            let pose = advance(&mut vehicle, start.pose, last.command, until.seconds_since(last.from));
            return VehicleState { pose, speed: vehicle.speed(), steering: vehicle.steering_state() };
        };
        let mut vehicle = Vehicle::moving(&self.car, start.speed, start.steering);
        let mut pose = start.pose;
        for (index, timed) in self.commands.iter().enumerate() {
            let end = self.commands.get(index + 1).map_or(until, |next| next.from.min(until));
            if end > now {
                // Before the first recorded command, that command is assumed, too.
                let command = timed.command;
                pose = advance(&mut vehicle, pose, command, end.seconds_since(now));
                now = end;
            }
        }
        VehicleState { pose, speed: vehicle.speed(), steering: vehicle.steering_state() }
    }
}

fn advance(vehicle: &mut Vehicle, mut pose: Pose2, command: Command, seconds: f64) -> Pose2 {
    let mut left = seconds.max(0.0);
    while left > 0.0 {
        let step = left.min(MAX_STEP);
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
    fn a_late_pose_is_predicted_to_the_present() {
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
            let timed = history.commands.back().unwrap().command;
            pose = pose * vehicle.step(timed, 0.005).motion(0.005);
        }
        for age in [1, 7, 30, 100] {
            let (then, before, speed) = poses[399 - age];
            let (now, truth, _) = poses[399];
            let without_speed = history.predict(before, then, None, now);
            let with_speed = history.predict(before, then, Some(speed), now);
            for found in [without_speed, with_speed] {
                let error = truth.between(&found.pose);
                assert!(error.distance() < 1e-9 && error.theta.abs() < 1e-9, "{age}: {error:?}");
            }
        }
    }

    #[test]
    fn without_commands_the_pose_is_unchanged() {
        let history = CommandHistory::new(VehicleKnobs::default());
        assert_eq!(history.predict(Pose2::new(1.0, 0.0, 0.0), stamp(0), None, stamp(100)).pose, Pose2::new(1.0, 0.0, 0.0));
    }
}
