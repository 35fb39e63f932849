//! How particles move: as odometry says, with the errors it may have.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::geometry::{Pose2, Twist2};
use crate::simulation::racecar;

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
        /// Standard deviation of the part by which odometry's distances are all too long or too short.
        scale_error: f64 = 0.05, in 0 to 0.5;
        /// Way after which that part has become another one.
        scale_reach: f64 = 20.0, in 0.1 to 10_000, unit "m";
        /// Standard deviation of the speed (car).
        speed_error: f64 = 0.1, in 0 to 10, unit "m/s";
        /// Standard deviation of the steering angle (car).
        steering_error: f64 = 10.0, in 0 to 60, unit "deg";
        /// Standard deviation of the angle at which tyres slip sideways (car).
        sideslip_error: f64 = 2.0, in 0 to 45, unit "deg";
        /// Distance between the axles (car).
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 10, unit "m";
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
///
/// Those of one step average out over many, but a wheel that is smaller than it is taken to be makes every way too long in proportion: where
/// scans tell little of the way, as in a corridor, the cloud then ends up ahead of the robot by many times what it takes itself to be off.
/// So each particle has a scale of its own, and those whose scale is right survive. The scale wanders, as load and slip change (an
/// Ornstein-Uhlenbeck process along the way).
#[derive(Clone, Debug)]
pub(super) struct UncertainMotion {
    errors: Errors,
    /// What remains of the scale, and the standard deviation of what replaces the rest.
    keep: f32,
    renew: f32,
}

/// By the model.
#[derive(Clone, Debug)]
enum Errors {
    Car { twist: Twist2, steering: f64, seconds: f64, speed_error: f64, steering_error: f64, sideslip_error: f64, wheelbase: f64 },
    Differential { rotations: [f64; 2], way: f64, deviations: [f64; 3] },
}

impl Errors {
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
}

impl UncertainMotion {
    /// `motion`, seen from its start, took `seconds`.
    pub(super) fn new(knobs: &MotionKnobs, motion: &Pose2, seconds: f64) -> Self {
        let errors = match knobs.model {
            MotionModel::Car => Errors::car(knobs, motion, seconds.max(1e-6)),
            MotionModel::Differential => Errors::differential(knobs, motion),
        };
        let keep = (-motion.distance() / knobs.scale_reach).exp();
        Self { errors, keep: keep as f32, renew: (knobs.scale_error * (1.0 - keep * keep).sqrt()) as f32 }
    }

    /// One of the motions that it may have been where distances are longer by the part `scale`, which wanders on.
    #[inline]
    pub(super) fn sample(&self, scale: &mut f32, random: &mut impl Rng) -> Sampled {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        *scale = self.keep * *scale + self.renew * normal() as f32;
        let stretch = 1.0 + f64::from(*scale);
        match &self.errors {
            Errors::Car { twist, steering, seconds, speed_error, steering_error, sideslip_error, wheelbase } => {
                let speed = twist.vx + speed_error * normal();
                let error = steering_error * normal();
                let omega = if twist.vx.abs() > STANDING {
                    speed * (steering + error).clamp(-MAX_STEERING, MAX_STEERING).tan() / wheelbase
                } else {
                    twist.omega + speed * error.clamp(-MAX_STEERING, MAX_STEERING).tan() / wheelbase
                };
                let turn = omega * seconds;
                let direction = 0.5 * turn + sideslip_error * normal();
                Sampled { ahead: speed * seconds * stretch, left: twist.vy * seconds * stretch, direction, turn }
            }
            Errors::Differential { rotations: [first, second], way, deviations } => {
                let first = first + deviations[0] * normal();
                let way = way * stretch + deviations[1] * normal();
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
    fn a_scale_stays_for_metres_and_is_forgotten_over_many() {
        let knobs = MotionKnobs::default();
        let uncertain = UncertainMotion::new(&knobs, &Pose2::new(0.1, 0.0, 0.0), 0.05);
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        let mut scales = vec![0.1_f32; 2000];
        let mut after = |steps: u32| {
            for scale in &mut scales {
                (0..steps).for_each(|_| {
                    uncertain.sample(scale, &mut random);
                });
            }
            let mean = scales.iter().sum::<f32>() / scales.len() as f32;
            let variance = scales.iter().map(|scale| (scale - mean).powi(2)).sum::<f32>() / scales.len() as f32;
            (f64::from(mean), f64::from(variance.sqrt()))
        };
        let (mean, deviation) = after(10);
        assert!(mean > 0.09 && deviation < 0.02, "after a metre: {mean}, {deviation}");
        let (mean, deviation) = after(1000);
        assert!(mean.abs() < 0.005 && (deviation - knobs.scale_error).abs() < 0.005, "after a hundred: {mean}, {deviation}");
    }

    #[test]
    fn samples_lie_about_the_motion_as_far_as_the_errors_say() {
        let motion = Twist2 { vx: 2.0, vy: 0.0, omega: 1.0 }.motion(0.1);
        for &model in MotionModel::ALL {
            let knobs = MotionKnobs { model, ..MotionKnobs::default() };
            let uncertain = UncertainMotion::new(&knobs, &motion, 0.1);
            let mut random = rand_pcg::Pcg64::seed_from_u64(1);
            let samples: Vec<Sampled> = (0..20_000).map(|_| uncertain.sample(&mut 0.0, &mut random)).collect();
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
