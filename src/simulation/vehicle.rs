//! Vehicle model: how a simulated car executes commands within its limits.

use super::racecar;
use crate::geometry::Twist2;
use crate::{choices, knobs};

choices! {
    /// Kinematics of the car.
    pub enum Drive {
        /// Front-wheel steering: kinematic single-track (bicycle) model.
        Ackermann = "ackermann",
        /// Differential drive: left and right wheels run at different speeds.
        Differential = "differential",
    }
}

knobs! {
    /// Limits of the simulated car.
    pub struct VehicleKnobs {
        /// Kinematics.
        drive: Drive = Drive::Ackermann;
        /// Top speed; curves reduce it.
        speed: f64 = 3.0, in 0.1 to 20, unit "m/s";
        /// Maximum acceleration and deceleration.
        acceleration: f64 = 2.0, in 0.1 to 20, unit "m/s^2";
        /// Maximum lateral acceleration; limits the speed in curves.
        lateral_acceleration: f64 = 3.0, in 0.1 to 20, unit "m/s^2";
        /// Distance between the axles (Ackermann). `base_link` is at the rear axle.
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 5, unit "m";
        /// Maximum steering angle (Ackermann).
        max_steering: f64 = racecar::MAX_STEERING, in 0.05 to 1.4, unit "rad";
        /// Maximum rate of the steering angle (Ackermann).
        steering_rate: f64 = racecar::STEERING_RATE, in 0.1 to 20, unit "rad/s";
        /// Maximum yaw acceleration (differential).
        yaw_acceleration: f64 = 12.0, in 0.1 to 100, unit "rad/s^2";
    }
}

/// A motion command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Forward speed, m/s.
    pub speed: f64,
    /// Curvature of the path, 1/m, positive to the left.
    pub curvature: f64,
}

/// State of a car: speed, and steering angle or yaw rate.
#[derive(Clone, Debug)]
pub struct Vehicle<'a> {
    knobs: &'a VehicleKnobs,
    speed: f64,
    /// The steering angle, rad (Ackermann), or the yaw rate, rad/s (differential).
    steering_state: f64,
}

impl<'a> Vehicle<'a> {
    /// A car at rest.
    pub fn new(knobs: &'a VehicleKnobs) -> Self {
        Self { knobs, speed: 0.0, steering_state: 0.0 }
    }

    /// A moving car: `steering_state` is its steering angle, rad (Ackermann), or its yaw rate, rad/s (differential).
    pub fn moving(knobs: &'a VehicleKnobs, speed: f64, steering_state: f64) -> Self {
        Self { knobs, speed, steering_state }
    }

    /// The steering angle, rad (Ackermann), or the yaw rate, rad/s (differential).
    pub fn steering_state(&self) -> f64 {
        self.steering_state
    }

    /// Forward speed, m/s.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Stops at once, with straight wheels.
    pub fn stop(&mut self) {
        (self.speed, self.steering_state) = (0.0, 0.0);
    }

    /// Executes a command for `seconds` within the limits of the car. Returns the velocity of the rear axle during that time.
    pub fn step(&mut self, command: Command, seconds: f64) -> Twist2 {
        let knobs = self.knobs;
        self.speed = approach(self.speed, command.speed, knobs.acceleration * seconds);
        let omega = match knobs.drive {
            Drive::Ackermann => {
                let steering = (knobs.wheelbase * command.curvature).atan().clamp(-knobs.max_steering, knobs.max_steering);
                self.steering_state = approach(self.steering_state, steering, knobs.steering_rate * seconds);
                self.speed * self.steering_state.tan() / knobs.wheelbase
            }
            Drive::Differential => {
                self.steering_state =
                    approach(self.steering_state, self.speed * command.curvature, knobs.yaw_acceleration * seconds);
                self.steering_state
            }
        };
        Twist2 { vx: self.speed, vy: 0.0, omega }
    }
}

/// `value`, changed towards `target` by at most `max_change`.
fn approach(value: f64, target: f64, max_change: f64) -> f64 {
    value + (target - value).clamp(-max_change, max_change)
}
