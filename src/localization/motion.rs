//! The motion model: particles move as odometry states, with sampled errors.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::geometry::{Pose2, Twist2};
use crate::simulation::racecar;

/// Minimum speed at which the steering angle can be computed from the yaw rate, m/s.
const MIN_SPEED: f64 = 0.05;
/// Maximum steering angle, rad.
const MAX_STEERING: f64 = 1.2;
/// Minimum translation with a direction of travel, m. Below it, a robot rotates in place.
const MIN_TRANSLATION: f64 = 0.01;

crate::choices! {
    /// The motion models.
    pub enum MotionModel {
        /// A car: speed and steering angle are uncertain.
        Car = "car",
        /// A differential drive: rotation, translation and rotation, with errors proportional to them (Thrun et al., 2005).
        Differential = "differential",
    }
}

crate::knobs! {
    /// The motion model and the errors of odometry.
    pub struct MotionKnobs {
        /// Motion model.
        model: MotionModel = MotionModel::Car;
        /// Standard deviation of the relative scale error of odometry's distances.
        scale_error: f64 = 0.05, in 0 to 0.5;
        /// Distance over which the scale error changes (correlation length).
        scale_reach: f64 = 20.0, in 0.1 to 10_000, unit "m";
        /// Standard deviation of the speed (car).
        speed_error: f64 = 0.1, in 0 to 10, unit "m/s";
        /// Standard deviation of the steering angle (car).
        steering_error: f64 = 10.0, in 0 to 60, unit "deg";
        /// Standard deviation of the sideslip angle of the tyres (car).
        sideslip_error: f64 = 2.0, in 0 to 45, unit "deg";
        /// Wheelbase (car).
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 10, unit "m";
        /// Error of rotation per rotation (differential).
        alpha1: f64 = 0.1, in 0 to 10;
        /// Error of rotation per translation (differential).
        alpha2: f64 = 0.1, in 0 to 10, unit "rad/m";
        /// Error of translation per translation (differential).
        alpha3: f64 = 0.1, in 0 to 10;
        /// Error of translation per rotation (differential).
        alpha4: f64 = 0.05, in 0 to 10, unit "m/rad";
    }
}

/// A motion with uncertain errors.
///
/// Independent errors of the steps average out, but a wheel that is smaller than assumed makes every distance too long by the
/// same factor. Where scans constrain the distance little, as in a corridor, the cloud then drifts ahead of the robot by many
/// times its estimated error. Therefore each particle has a scale error of its own, and the particles with the right scale
/// survive. The scale changes slowly with load and slip (an Ornstein-Uhlenbeck process over the distance).
#[derive(Clone, Debug)]
pub(super) struct UncertainMotion {
    errors: Errors,
    /// Factor of the scale error that remains after this motion.
    keep: f32,
    /// Standard deviation of the noise added to the scale error.
    renew: f32,
}

/// The errors by motion model.
#[derive(Clone, Debug)]
enum Errors {
    Car { twist: Twist2, steering: f64, seconds: f64, speed_error: f64, steering_error: f64, sideslip_error: f64, wheelbase: f64 },
    Differential { rotations: [f64; 2], distance: f64, deviations: [f64; 3] },
}

impl Errors {
    fn car(knobs: &MotionKnobs, motion: &Pose2, seconds: f64) -> Self {
        let twist = Twist2::from_motion(motion, seconds);
        let moving = twist.vx.abs() > MIN_SPEED;
        let steering = if moving { (knobs.wheelbase * twist.omega / twist.vx).atan() } else { 0.0 };
        let [steering_error, sideslip_error] = [knobs.steering_error, knobs.sideslip_error].map(f64::to_radians);
        let speed_error = knobs.speed_error;
        Self::Car { twist, steering, seconds, speed_error, steering_error, sideslip_error, wheelbase: knobs.wheelbase }
    }

    fn differential(knobs: &MotionKnobs, motion: &Pose2) -> Self {
        let distance = motion.distance();
        let first = if distance < MIN_TRANSLATION { 0.0 } else { motion.y.atan2(motion.x) };
        let second = Pose2::new(0.0, 0.0, motion.theta - first).theta;
        // Driving backwards is not a rotation by half a turn.
        let magnitude = |angle: f64| angle.abs().min(std::f64::consts::PI - angle.abs());
        let rotation = |angle: f64| (knobs.alpha1 * magnitude(angle)).hypot(knobs.alpha2 * distance);
        let both = magnitude(first).hypot(magnitude(second));
        let deviations = [rotation(first), (knobs.alpha3 * distance).hypot(knobs.alpha4 * both), rotation(second)];
        Self::Differential { rotations: [first, second], distance, deviations }
    }
}

impl UncertainMotion {
    /// A motion in the frame of its start that took `seconds`.
    pub(super) fn new(knobs: &MotionKnobs, motion: &Pose2, seconds: f64) -> Self {
        let errors = match knobs.model {
            MotionModel::Car => Errors::car(knobs, motion, seconds.max(1e-6)),
            MotionModel::Differential => Errors::differential(knobs, motion),
        };
        let keep = (-motion.distance() / knobs.scale_reach).exp();
        Self { errors, keep: keep as f32, renew: (knobs.scale_error * (1.0 - keep * keep).sqrt()) as f32 }
    }

    /// Samples a motion whose distances are longer by the fraction `scale`; `scale` itself changes, too.
    #[inline]
    pub(super) fn sample(&self, scale: &mut f32, random: &mut impl Rng) -> SampledMotion {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        *scale = self.keep * *scale + self.renew * normal() as f32;
        let scale_factor = 1.0 + f64::from(*scale);
        match &self.errors {
            Errors::Car { twist, steering, seconds, speed_error, steering_error, sideslip_error, wheelbase } => {
                let speed = twist.vx + speed_error * normal();
                let error = steering_error * normal();
                let omega = if twist.vx.abs() > MIN_SPEED {
                    speed * (steering + error).clamp(-MAX_STEERING, MAX_STEERING).tan() / wheelbase
                } else {
                    twist.omega + speed * error.clamp(-MAX_STEERING, MAX_STEERING).tan() / wheelbase
                };
                let rotation = omega * seconds;
                let direction = 0.5 * rotation + sideslip_error * normal();
                SampledMotion {
                    forward: speed * seconds * scale_factor,
                    left: twist.vy * seconds * scale_factor,
                    direction,
                    rotation,
                }
            }
            Errors::Differential { rotations: [first, second], distance, deviations } => {
                let first = first + deviations[0] * normal();
                let distance = distance * scale_factor + deviations[1] * normal();
                let second = second + deviations[2] * normal();
                SampledMotion { forward: distance, left: 0.0, direction: first, rotation: first + second }
            }
        }
    }
}

/// A sampled motion: `forward` and `left`, m, in a frame rotated by `direction`, rad; the heading changes by `rotation`, rad.
pub(super) struct SampledMotion {
    pub(super) forward: f64,
    pub(super) left: f64,
    pub(super) direction: f64,
    pub(super) rotation: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_scale_error_persists_over_metres_and_decays_over_many() {
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
    fn samples_scatter_around_the_motion_as_the_errors_specify() {
        let motion = Twist2 { vx: 2.0, vy: 0.0, omega: 1.0 }.motion(0.1);
        for &model in MotionModel::ALL {
            let knobs = MotionKnobs { model, ..MotionKnobs::default() };
            let uncertain = UncertainMotion::new(&knobs, &motion, 0.1);
            let mut random = rand_pcg::Pcg64::seed_from_u64(1);
            let samples: Vec<SampledMotion> = (0..20_000).map(|_| uncertain.sample(&mut 0.0, &mut random)).collect();
            let mean = |of: fn(&SampledMotion) -> f64| samples.iter().map(of).sum::<f64>() / samples.len() as f64;
            let deviation = |of: fn(&SampledMotion) -> f64| {
                let mean = mean(of);
                (samples.iter().map(|sample| (of(sample) - mean).powi(2)).sum::<f64>() / samples.len() as f64).sqrt()
            };
            let x = mean(|sample| sample.forward * sample.direction.cos() - sample.left * sample.direction.sin());
            assert!((x - motion.x).abs() < 1e-3, "{}: {x}", model.name());
            assert!((mean(|sample| sample.rotation) - motion.theta).abs() < 5e-3, "{}", model.name());
            if model == MotionModel::Car {
                assert!((deviation(|sample| sample.forward) - 0.01).abs() < 5e-4);
                // v / L * sigma / cos^2(steering) * dt
                let rotation = deviation(|sample| sample.rotation);
                assert!((0.10..0.125).contains(&rotation), "{rotation}");
            }
        }
    }
}
