//! How a simulated car moves: what it can do of what it is told.

use super::racecar;
use crate::geometry::Twist2;
use crate::{choices, knobs};

choices! {
    /// How the car turns.
    pub enum Drive {
        /// Front wheels steer: the kinematic single-track model.
        Ackermann = "ackermann",
        /// Left and right wheels run at different speeds.
        Differential = "differential",
    }
}

knobs! {
    /// What the simulated car can do.
    pub struct VehicleKnobs {
        /// How it turns.
        drive: Drive = Drive::Ackermann;
        /// Top speed; it goes slower in curves.
        speed: f64 = 3.0, in 0.1 to 20, unit "m/s";
        /// Acceleration and braking.
        acceleration: f64 = 2.0, in 0.1 to 20, unit "m/s^2";
        /// Lateral acceleration in curves, which limits the speed there.
        lateral_acceleration: f64 = 3.0, in 0.1 to 20, unit "m/s^2";
        /// Distance between the axles (Ackermann). The rear one carries `base_link`.
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 5, unit "m";
        /// Greatest steering angle (Ackermann).
        max_steering: f64 = racecar::MAX_STEERING, in 0.05 to 1.4, unit "rad";
        /// Greatest change of the steering angle (Ackermann).
        steering_rate: f64 = racecar::STEERING_RATE, in 0.1 to 20, unit "rad/s";
        /// Greatest change of the yaw rate (differential).
        yaw_acceleration: f64 = 12.0, in 0.1 to 100, unit "rad/s^2";
    }
}

/// What the driver wants.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Forward speed, m/s.
    pub speed: f64,
    /// Curvature of the path, 1/m, positive to the left.
    pub curvature: f64,
}

/// A car at some speed, with its wheels at some angle.
#[derive(Clone, Debug)]
pub struct Vehicle<'a> {
    knobs: &'a VehicleKnobs,
    speed: f64,
    /// The steering angle, rad (Ackermann), or the yaw rate, rad/s (differential).
    turn: f64,
}

impl<'a> Vehicle<'a> {
    /// A car at rest.
    pub fn new(knobs: &'a VehicleKnobs) -> Self {
        Self { knobs, speed: 0.0, turn: 0.0 }
    }

    /// A car on its way: `turn` is its steering angle, rad (Ackermann), or its yaw rate, rad/s (differential).
    pub fn moving(knobs: &'a VehicleKnobs, speed: f64, turn: f64) -> Self {
        Self { knobs, speed, turn }
    }

    /// The steering angle, rad (Ackermann), or the yaw rate, rad/s (differential).
    pub fn turn(&self) -> f64 {
        self.turn
    }

    /// Forward speed, m/s.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Comes to rest at once, its wheels straight.
    pub fn stop(&mut self) {
        (self.speed, self.turn) = (0.0, 0.0);
    }

    /// Carries out a command for `seconds`, as far as the car can. Returns the velocity of the rear axle during that time.
    pub fn step(&mut self, command: Command, seconds: f64) -> Twist2 {
        let knobs = self.knobs;
        self.speed = approach(self.speed, command.speed, knobs.acceleration * seconds);
        let omega = match knobs.drive {
            Drive::Ackermann => {
                let steering = (knobs.wheelbase * command.curvature).atan().clamp(-knobs.max_steering, knobs.max_steering);
                self.turn = approach(self.turn, steering, knobs.steering_rate * seconds);
                self.speed * self.turn.tan() / knobs.wheelbase
            }
            Drive::Differential => {
                self.turn = approach(self.turn, self.speed * command.curvature, knobs.yaw_acceleration * seconds);
                self.turn
            }
        };
        Twist2 { vx: self.speed, vy: 0.0, omega }
    }
}

/// `value`, moved towards `target` by at most `most`.
fn approach(value: f64, target: f64, most: f64) -> f64 {
    value + (target - value).clamp(-most, most)
}
