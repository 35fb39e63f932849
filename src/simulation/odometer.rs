//! Simulated wheel odometry, wrong in the ways that real odometry is wrong.
//!
//! Every drive has its own error of scale in distance and in turning, and its own steady drift to one side, drawn once; on top of
//! these comes noise that grows with the way the wheels roll. A car at rest reads exactly zero. The covariances are those of this
//! very model, to first order.

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
        /// Standard deviation from drive to drive of the relative error of distances.
        distance_scale: f64 = 0.02, in 0 to 0.5;
        /// Standard deviation from drive to drive of the relative error of angles.
        yaw_scale: f64 = 0.03, in 0 to 0.5;
        /// Standard deviation from drive to drive of the steady turn to one side.
        yaw_drift: f64 = 0.005, in 0 to 0.5, unit "rad/m";
        /// Standard deviation of the distance after a metre.
        distance_noise: f64 = 0.01, in 0 to 0.5, unit "m/sqrt(m)";
        /// Standard deviation of the heading after a metre.
        yaw_noise: f64 = 0.005, in 0 to 0.5, unit "rad/sqrt(m)";
    }
}

/// The frame in which odometry begins at the identity.
pub const ODOM_FRAME: &str = "odom";
/// The frame of the car.
pub const BASE_FRAME: &str = "base_link";
/// Half the distance of the wheels, m: the way they roll per radian when the car turns on the spot.
const HALF_TRACK: f64 = 0.15;
/// Variance stated for what cannot vary (height, roll, pitch, anything at rest): readers take 0 for "not measured".
const NEXT_TO_NOTHING: f64 = 1e-6;

/// The wheel odometry of a car.
#[derive(Clone, Debug)]
pub struct Odometer<'a> {
    knobs: &'a OdometerKnobs,
    random: Pcg64,
    /// The errors of this drive: of distances, of angles, and the drift, rad/m.
    bias: Vector3<f64>,
    /// Where the car was when last asked.
    map_from_base: Pose2,
    estimate: Estimate,
}

impl<'a> Odometer<'a> {
    /// The odometry of a car that stands at `map_from_base`.
    pub fn new(knobs: &'a OdometerKnobs, map_from_base: Pose2, mut random: Pcg64) -> Self {
        let bias = bias_deviations(knobs).map(|deviation| deviation * draw(&mut random));
        Self { knobs, random, bias, map_from_base, estimate: Estimate::default() }
    }

    /// The reading when the car has come to `map_from_base`, one period after the last reading.
    pub fn read(&mut self, map_from_base: Pose2, stamp: Stamp) -> Odometry {
        let moved = self.map_from_base.between(&map_from_base);
        self.map_from_base = map_from_base;
        let truth = Twist2::of_motion(&moved, 1.0);
        let rolled = truth.vx.hypot(truth.vy) + HALF_TRACK * truth.omega.abs();
        let noise = [self.knobs.distance_noise, self.knobs.yaw_noise].map(|deviation| deviation * rolled.sqrt());
        let measured = Twist2 {
            vx: truth.vx * (1.0 + self.bias.x) + noise[0] * draw(&mut self.random),
            vy: truth.vy,
            omega: truth.omega * (1.0 + self.bias.y) + truth.vx * self.bias.z + noise[1] * draw(&mut self.random),
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

fn draw(random: &mut Pcg64) -> f64 {
    StandardNormal.sample(random)
}

fn bias_deviations(knobs: &OdometerKnobs) -> Vector3<f64> {
    Vector3::new(knobs.distance_scale, knobs.yaw_scale, knobs.yaw_drift)
}

/// What the wheels say of the way since the last reading.
struct Step {
    /// The arc: m, m, rad.
    measured: Twist2,
    /// Of the noise in distance and angle.
    variances: [f64; 2],
}

impl Step {
    /// Derivatives of distance, side step and angle by the errors of the drive.
    fn by_bias(&self) -> Matrix3<f64> {
        let Twist2 { vx, omega, .. } = self.measured;
        Matrix3::new(vx, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, omega, vx)
    }

    /// Covariance of distance, side step and angle.
    fn covariance(&self, bias_deviations: Vector3<f64>) -> Matrix3<f64> {
        let [distance, angle] = self.variances;
        squared(&(self.by_bias() * Matrix3::from_diagonal(&bias_deviations)))
            + Matrix3::from_diagonal(&Vector3::new(distance, 0.0, angle))
    }
}

/// The pose that follows from the steps, and how wrong it may be.
#[derive(Clone, Debug, Default)]
struct Estimate {
    odom_from_base: Pose2,
    /// Covariance due to the noise.
    by_noise: PoseCovariance,
    /// Derivatives of the pose by the errors of the drive. These go on from step to step: their effect adds up, that of noise
    /// partly cancels.
    by_bias: Matrix3<f64>,
}

impl Estimate {
    fn advance(&mut self, step: &Step) {
        let before = self.odom_from_base;
        let after = before * step.measured.motion(1.0);
        // An error of the heading before swings the step round its beginning.
        let by_before = Matrix3::new(1.0, 0.0, before.y - after.y, 0.0, 1.0, after.x - before.x, 0.0, 0.0, 1.0);
        // An error of the angle turned swings it half as far; an error of distance lies along the chord.
        let (sin, cos) = (before.theta + 0.5 * step.measured.omega).sin_cos();
        let by_distance = Vector3::new(cos, sin, 0.0);
        let by_angle = Vector3::new(0.5 * (before.y - after.y), 0.5 * (after.x - before.x), 1.0);
        let by_step = Matrix3x2::from_columns(&[by_distance, by_angle]);
        let noise = by_step * Matrix2::from_diagonal(&step.variances.into()) * by_step.transpose();
        self.by_noise = by_before * self.by_noise * by_before.transpose() + noise;
        let step_by_bias = step.by_bias().remove_row(1);
        self.by_bias = by_before * self.by_bias + by_step * step_by_bias;
        self.odom_from_base = after;
    }

    fn covariance(&self, bias_deviations: Vector3<f64>) -> PoseCovariance {
        self.by_noise + squared(&(self.by_bias * Matrix3::from_diagonal(&bias_deviations)))
    }
}

fn squared(root: &Matrix3<f64>) -> Matrix3<f64> {
    root * root.transpose()
}

/// A covariance of x, y, yaw as messages carry it.
fn wire_covariance(covariance: &PoseCovariance) -> Covariance {
    full_covariance(&(covariance + Matrix3::from_diagonal_element(NEXT_TO_NOTHING)), NEXT_TO_NOTHING)
}
