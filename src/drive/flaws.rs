//! What a car does otherwise than it is told: the follower's model of it is never quite right.

use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64;

use crate::knobs;
use crate::simulation::vehicle::Command;

knobs! {
    /// How far the car is from the follower's model of it.
    pub struct FlawKnobs {
        /// Standard deviation from drive to drive of the steering angle when the wheels are to be straight.
        steering_offset: f64 = 0.5, in 0 to 20, unit "deg";
        /// Standard deviation from drive to drive of the relative error of the steering angle.
        steering_scale: f64 = 0.03, in 0 to 0.5;
        /// Standard deviation from drive to drive of the relative error of the speed.
        speed_scale: f64 = 0.03, in 0 to 0.5;
    }
}

/// The flaws of the car of one drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct CarFlaws {
    wheelbase: f64,
    steering_offset: f64,
    steering_scale: f64,
    speed_scale: f64,
}

impl CarFlaws {
    pub(super) fn draw(knobs: &FlawKnobs, wheelbase: f64, mut random: Pcg64) -> Self {
        let mut draw = |deviation: f64| -> f64 {
            let error: f64 = StandardNormal.sample(&mut random);
            deviation * error
        };
        Self {
            wheelbase,
            steering_offset: draw(knobs.steering_offset.to_radians()),
            steering_scale: 1.0 + draw(knobs.steering_scale),
            speed_scale: 1.0 + draw(knobs.speed_scale),
        }
    }

    /// What the car makes of a command.
    pub(super) fn done(&self, command: Command) -> Command {
        let steering = (self.wheelbase * command.curvature).atan() * self.steering_scale + self.steering_offset;
        Command { speed: command.speed * self.speed_scale, curvature: steering.tan() / self.wheelbase }
    }
}
