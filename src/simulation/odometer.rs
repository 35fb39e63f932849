//! Simulated wheel odometry with the typical errors of real odometry.
//!
//! Every drive has its own scale errors of distance and rotation and its own constant drift to one side, sampled once. In
//! addition there is noise that grows with the distance that the wheels roll. A car at rest reads exactly zero. The covariances
//! follow from this model to first order.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector3};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::knobs;
use crate::messages::geometry_msgs::{
    Covariance, PoseWithCovariance, Twist, TwistWithCovariance, Vector3 as WireVector, full_covariance,
};
use crate::messages::nav_msgs::Odometry;
use crate::messages::std_msgs::Header;
use crate::time::Stamp;

knobs! {
    /// The simulated wheel odometry.
    pub struct OdometerKnobs {
        /// Readings per second.
        rate: f64 = 50.0, in 0.1 to 1000, unit "Hz";
        /// Standard deviation between drives of the relative error of distances.
        distance_scale: f64 = 0.02, in 0 to 0.5;
        /// Standard deviation between drives of the relative error of angles.
        yaw_scale: f64 = 0.03, in 0 to 0.5;
        /// Standard deviation between drives of the constant drift of the heading.
        yaw_drift: f64 = 0.005, in 0 to 0.5, unit "rad/m";
        /// Standard deviation of the measured distance after a metre.
        distance_noise: f64 = 0.01, in 0 to 0.5, unit "m/sqrt(m)";
        /// Standard deviation of the measured heading after a metre.
        yaw_noise: f64 = 0.005, in 0 to 0.5, unit "rad/sqrt(m)";
    }
}

/// Frame of the odometry, which begins at the identity.
pub const ODOM_FRAME: &str = "odom";
/// Frame of the car.
pub const BASE_FRAME: &str = "base_link";
/// Half the track width, m: the distance that the wheels roll per radian of rotation.
const HALF_TRACK: f64 = 0.15;
/// Minimum variance in the messages, for components that cannot vary (height, roll, pitch, everything at rest): readers interpret
/// 0 as "not measured".
const MIN_VARIANCE: f64 = 1e-6;

/// The wheel odometry of a car.
#[derive(Clone, Debug)]
pub struct Odometer<'a> {
    knobs: &'a OdometerKnobs,
    random: Pcg64,
    /// Systematic errors of this drive: relative errors of distances and angles, and the drift, rad/m.
    bias: Vector3<f64>,
    /// True pose at the last reading.
    map_from_base: Pose2,
    estimate: DeadReckoning,
}

impl<'a> Odometer<'a> {
    /// The odometry of a car at rest at `map_from_base`.
    pub fn new(knobs: &'a OdometerKnobs, map_from_base: Pose2, mut random: Pcg64) -> Self {
        let bias = bias_deviations(knobs).map(|deviation| deviation * sample_normal(&mut random));
        Self { knobs, random, bias, map_from_base, estimate: DeadReckoning::default() }
    }

    /// The reading when the car is at `map_from_base`, one period after the last reading.
    pub fn read(&mut self, map_from_base: Pose2, stamp: Stamp) -> Odometry {
        let moved = self.map_from_base.between(&map_from_base);
        self.map_from_base = map_from_base;
        let truth = Twist2::from_motion(&moved, 1.0);
        let rolled = truth.vx.hypot(truth.vy) + HALF_TRACK * truth.omega.abs();
        let noise = [self.knobs.distance_noise, self.knobs.yaw_noise].map(|deviation| deviation * rolled.sqrt());
        let measured = Twist2 {
            vx: truth.vx * (1.0 + self.bias.x) + noise[0] * sample_normal(&mut self.random),
            vy: truth.vy,
            omega: truth.omega * (1.0 + self.bias.y) + truth.vx * self.bias.z + noise[1] * sample_normal(&mut self.random),
        };
        let step = Step { measured, variances: noise.map(|deviation| deviation * deviation) };
        self.estimate.advance(&step);
        self.message(&step, stamp)
    }

    fn message(&self, step: &Step, stamp: Stamp) -> Odometry {
        let rate = self.knobs.rate;
        let Twist2 { vx, vy, omega } = step.measured;
        let bias_deviations = bias_deviations(self.knobs);
        let twist = Twist {
            linear: WireVector { x: vx * rate, y: vy * rate, z: 0.0 },
            angular: WireVector { x: 0.0, y: 0.0, z: omega * rate },
        };
        Odometry {
            header: Header { stamp: stamp.into(), frame_id: ODOM_FRAME.into(), ..Header::default() },
            child_frame_id: BASE_FRAME.into(),
            pose: PoseWithCovariance {
                pose: self.estimate.odom_from_base.into(),
                covariance: wire_covariance(&self.estimate.covariance(bias_deviations)),
            },
            twist: TwistWithCovariance { twist, covariance: wire_covariance(&(step.covariance(bias_deviations) * rate * rate)) },
        }
    }
}

fn sample_normal(random: &mut Pcg64) -> f64 {
    StandardNormal.sample(random)
}

fn bias_deviations(knobs: &OdometerKnobs) -> Vector3<f64> {
    Vector3::new(knobs.distance_scale, knobs.yaw_scale, knobs.yaw_drift)
}

/// The measured motion since the last reading.
struct Step {
    /// The arc: x, m; y, m; rotation, rad.
    measured: Twist2,
    /// Variances of the noise in distance and angle.
    variances: [f64; 2],
}

impl Step {
    /// Jacobian of distance, lateral motion and angle with respect to the systematic errors.
    fn bias_jacobian(&self) -> Matrix3<f64> {
        let Twist2 { vx, omega, .. } = self.measured;
        Matrix3::new(vx, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, omega, vx)
    }

    /// Covariance of distance, lateral motion and angle.
    fn covariance(&self, bias_deviations: Vector3<f64>) -> Matrix3<f64> {
        let [distance, angle] = self.variances;
        times_transpose(&(self.bias_jacobian() * Matrix3::from_diagonal(&bias_deviations)))
            + Matrix3::from_diagonal(&Vector3::new(distance, 0.0, angle))
    }
}

/// Integrates the measured steps to a pose with its uncertainty.
#[derive(Clone, Debug, Default)]
struct DeadReckoning {
    odom_from_base: Pose2,
    /// Covariance due to the noise.
    noise_covariance: PoseCovariance,
    /// Jacobian of the pose with respect to the systematic errors. They are the same in every step, so their effects add up,
    /// while those of the noise partly cancel.
    bias_jacobian: Matrix3<f64>,
}

impl DeadReckoning {
    fn advance(&mut self, step: &Step) {
        let before = self.odom_from_base;
        let after = before * step.measured.motion(1.0);
        // A heading error before the step rotates the step about its start.
        let before_jacobian = Matrix3::new(1.0, 0.0, before.y - after.y, 0.0, 1.0, after.x - before.x, 0.0, 0.0, 1.0);
        // An error of the step's angle rotates it by half; an error of the distance acts along the chord.
        let (sin, cos) = (before.theta + 0.5 * step.measured.omega).sin_cos();
        let by_distance = Vector3::new(cos, sin, 0.0);
        let by_angle = Vector3::new(0.5 * (before.y - after.y), 0.5 * (after.x - before.x), 1.0);
        let step_jacobian = Matrix3x2::from_columns(&[by_distance, by_angle]);
        let noise = step_jacobian * Matrix2::from_diagonal(&step.variances.into()) * step_jacobian.transpose();
        self.noise_covariance = before_jacobian * self.noise_covariance * before_jacobian.transpose() + noise;
        let step_bias_jacobian = step.bias_jacobian().remove_row(1);
        self.bias_jacobian = before_jacobian * self.bias_jacobian + step_jacobian * step_bias_jacobian;
        self.odom_from_base = after;
    }

    fn covariance(&self, bias_deviations: Vector3<f64>) -> PoseCovariance {
        self.noise_covariance + times_transpose(&(self.bias_jacobian * Matrix3::from_diagonal(&bias_deviations)))
    }
}

fn times_transpose(root: &Matrix3<f64>) -> Matrix3<f64> {
    root * root.transpose()
}

/// A covariance of x, y, yaw in the form of the message.
fn wire_covariance(covariance: &PoseCovariance) -> Covariance {
    full_covariance(&(covariance + Matrix3::from_diagonal_element(MIN_VARIANCE)), MIN_VARIANCE)
}
