//! How particles move: as odometry says, with the errors it may have.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::geometry::{Pose2, Twist2};

/// Slower than this the wheels' angle says nothing of the yaw rate, m/s.
const STANDING: f64 = 0.05;
/// No steering angle is larger, rad.
const MAX_STEERING: f64 = 1.2;
/// On a shorter way than this, a robot that turns on the spot has no direction of travel, m.
const ON_THE_SPOT: f64 = 0.01;

crate::choices! {
    /// The models of motion there are.
    pub enum MotionModel {
        /// Speed and steering angle of a car are uncertain.
        Car = "car",
        /// Rotation, translation, rotation, with errors in proportion to them (Thrun et al., 2005).
        Differential = "differential",
    }
}

crate::knobs! {
    /// The errors of odometry.
    pub struct MotionKnobs {
        /// Which model.
        model: MotionModel = MotionModel::Car;
        /// Standard deviation of the speed (car).
        speed_error: f64 = 0.1, in 0 to 10, unit "m/s";
        /// Standard deviation of the steering angle (car).
        steering_error: f64 = 10.0, in 0 to 60, unit "deg";
        /// Standard deviation of the angle at which tyres slip sideways (car).
        sideslip_error: f64 = 2.0, in 0 to 45, unit "deg";
        /// Distance between the axles (car).
        wheelbase: f64 = 0.33, in 0.05 to 10, unit "m";
        /// Error of rotation by rotation (differential).
        alpha1: f64 = 0.1, in 0 to 10;
        /// Error of rotation by translation (differential).
        alpha2: f64 = 0.1, in 0 to 10, unit "rad/m";
        /// Error of translation by translation (differential).
        alpha3: f64 = 0.1, in 0 to 10;
        /// Error of translation by rotation (differential).
        alpha4: f64 = 0.05, in 0 to 10, unit "m/rad";
    }
}

/// A motion that is known up to some errors.
#[derive(Clone, Debug)]
pub(super) enum UncertainMotion {
    Car { twist: Twist2, steering: f64, seconds: f64, speed_error: f64, steering_error: f64, sideslip_error: f64, wheelbase: f64 },
    Differential { rotations: [f64; 2], way: f64, deviations: [f64; 3] },
}

impl UncertainMotion {
    /// `motion`, seen from its start, took `seconds`.
    pub(super) fn new(knobs: &MotionKnobs, motion: &Pose2, seconds: f64) -> Self {
        match knobs.model {
            MotionModel::Car => Self::car(knobs, motion, seconds.max(1e-6)),
            MotionModel::Differential => Self::differential(knobs, motion),
        }
    }

    fn car(knobs: &MotionKnobs, motion: &Pose2, seconds: f64) -> Self {
        let twist = Twist2::of_motion(motion, seconds);
        let moving = twist.vx.abs() > STANDING;
        let steering = if moving { (knobs.wheelbase * twist.omega / twist.vx).atan() } else { 0.0 };
        let [steering_error, sideslip_error] = [knobs.steering_error, knobs.sideslip_error].map(f64::to_radians);
        let speed_error = knobs.speed_error;
        Self::Car { twist, steering, seconds, speed_error, steering_error, sideslip_error, wheelbase: knobs.wheelbase }
    }

    fn differential(knobs: &MotionKnobs, motion: &Pose2) -> Self {
        let way = motion.distance();
        let first = if way < ON_THE_SPOT { 0.0 } else { motion.y.atan2(motion.x) };
        let second = Pose2::new(0.0, 0.0, motion.theta - first).theta;
        // Driving backwards is no half turn.
        let turned = |angle: f64| angle.abs().min(std::f64::consts::PI - angle.abs());
        let rotation = |angle: f64| (knobs.alpha1 * turned(angle)).hypot(knobs.alpha2 * way);
        let both = turned(first).hypot(turned(second));
        let deviations = [rotation(first), (knobs.alpha3 * way).hypot(knobs.alpha4 * both), rotation(second)];
        Self::Differential { rotations: [first, second], way, deviations }
    }

    /// One of the motions that it may have been: the way, in metres, its direction seen from the start, and the turn.
    #[inline]
    pub(super) fn sample(&self, random: &mut impl Rng) -> Sampled {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        match self {
            Self::Car { twist, steering, seconds, speed_error, steering_error, sideslip_error, wheelbase } => {
                let speed = twist.vx + speed_error * normal();
                let error = steering_error * normal();
                let omega = if twist.vx.abs() > STANDING {
                    speed * (steering + error).clamp(-MAX_STEERING, MAX_STEERING).tan() / wheelbase
                } else {
                    twist.omega + speed * error.clamp(-MAX_STEERING, MAX_STEERING).tan() / wheelbase
                };
                let turn = omega * seconds;
                let direction = 0.5 * turn + sideslip_error * normal();
                Sampled { ahead: speed * seconds, left: twist.vy * seconds, direction, turn }
            }
            Self::Differential { rotations: [first, second], way, deviations } => {
                let first = first + deviations[0] * normal();
                let way = way + deviations[1] * normal();
                let second = second + deviations[2] * normal();
                Sampled { ahead: way, left: 0.0, direction: first, turn: first + second }
            }
        }
    }
}

/// A motion: `ahead` and `left`, m, in a frame turned by `direction`; the heading turns by `turn`, rad.
pub(super) struct Sampled {
    pub(super) ahead: f64,
    pub(super) left: f64,
    pub(super) direction: f64,
    pub(super) turn: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn samples_lie_about_the_motion_as_far_as_the_errors_say() {
        let motion = Twist2 { vx: 2.0, vy: 0.0, omega: 1.0 }.motion(0.1);
        for &model in MotionModel::ALL {
            let knobs = MotionKnobs { model, ..MotionKnobs::default() };
            let uncertain = UncertainMotion::new(&knobs, &motion, 0.1);
            let mut random = rand_pcg::Pcg64::seed_from_u64(1);
            let samples: Vec<Sampled> = (0..20_000).map(|_| uncertain.sample(&mut random)).collect();
            let mean = |of: fn(&Sampled) -> f64| samples.iter().map(of).sum::<f64>() / samples.len() as f64;
            let deviation = |of: fn(&Sampled) -> f64| {
                let mean = mean(of);
                (samples.iter().map(|sample| (of(sample) - mean).powi(2)).sum::<f64>() / samples.len() as f64).sqrt()
            };
            let x = mean(|sample| sample.ahead * sample.direction.cos() - sample.left * sample.direction.sin());
            assert!((x - motion.x).abs() < 1e-3, "{}: {x}", model.name());
            assert!((mean(|sample| sample.turn) - motion.theta).abs() < 5e-3, "{}", model.name());
            if model == MotionModel::Car {
                assert!((deviation(|sample| sample.ahead) - 0.01).abs() < 5e-4);
                // v / L * sigma / cos^2(steering) * dt
                let turn = deviation(|sample| sample.turn);
                assert!((0.10..0.125).contains(&turn), "{turn}");
            }
        }
    }
}
