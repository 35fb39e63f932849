//! Model errors of the car: it does not execute commands exactly as the follower's vehicle model assumes.

use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64;

use crate::knobs;
use crate::simulation::vehicle::Command;

knobs! {
    /// Deviations of the car from the follower's vehicle model.
    pub struct FlawKnobs {
        /// Standard deviation between drives of the steering offset: the steering angle when straight wheels are commanded.
        steering_offset: f64 = 0.5, in 0 to 20, unit "deg";
        /// Standard deviation between drives of the relative error of the steering angle.
        steering_scale: f64 = 0.03, in 0 to 0.5;
        /// Standard deviation between drives of the relative error of the speed.
        speed_scale: f64 = 0.03, in 0 to 0.5;
    }
}

/// The sampled model errors of the car in one drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct CarFlaws {
    wheelbase: f64,
    steering_offset: f64,
    steering_scale: f64,
    speed_scale: f64,
}

impl CarFlaws {
    pub(super) fn sample(knobs: &FlawKnobs, wheelbase: f64, mut random: Pcg64) -> Self {
        let mut normal = |deviation: f64| -> f64 {
            let error: f64 = StandardNormal.sample(&mut random);
            deviation * error
        };
        Self {
            wheelbase,
            steering_offset: normal(knobs.steering_offset.to_radians()),
            steering_scale: 1.0 + normal(knobs.steering_scale),
            speed_scale: 1.0 + normal(knobs.speed_scale),
        }
    }

    /// The command as the car executes it.
    pub(super) fn apply(&self, command: Command) -> Command {
        let steering = (self.wheelbase * command.curvature).atan() * self.steering_scale + self.steering_offset;
        Command { speed: command.speed * self.speed_scale, curvature: steering.tan() / self.wheelbase }
    }
}
