//! Motion model of the robot: a Kalman filter over the errors of pose and velocity (Kalman 1960) with white-noise acceleration,
//! so that a prediction does not depend on the scan rate (Bar-Shalom, Li and Kirubarajan 2001, section 6.2).

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::prediction::Prediction;
use super::uncertainty::{pose_jacobian, rotated, rotation};
use crate::geometry::{Pose2, PoseCovariance, Twist2, wrap_angle};

/// Process noise: spectral density of the linear acceleration, m^2/s^3, as of a car that brakes at 8 m/s^2 for half a second.
const ACCELERATION_NOISE: f64 = 5.0;
/// Process noise: spectral density of the angular acceleration, rad^2/s^3.
const ANGULAR_ACCELERATION_NOISE: f64 = 40.0;
/// Maximum time over which the velocity is predicted, s; after that it is unknown. A robot whose motion is unknown is assumed to
/// have stood still this long ago.
const MAX_PREDICTION_TIME: f64 = 1.0;

/// Velocity of the robot, and the joint uncertainty of pose and velocity.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionState {
    /// Velocity of the base.
    pub(super) twist: Twist2,
    /// Covariance of the errors of pose and velocity, in the base frame: m, m, rad, m/s, m/s, rad/s.
    covariance: Matrix6<f64>,
}

/// A predicted motion and the state after it.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictedMotion {
    /// Motion from the last pose, in the frame of that pose.
    motion: Pose2,
    /// The predicted state, if there is no measurement or none that tells how the robot moved.
    pub(super) state: MotionState,
}

impl MotionState {
    /// A robot whose velocity is unknown: it can have accelerated for [`MAX_PREDICTION_TIME`]. `covariance` is that of its pose,
    /// along the axes of the base.
    pub(super) fn unknown(covariance: &PoseCovariance) -> Self {
        Self {
            twist: Twist2::default(),
            covariance: blocks(covariance, &Matrix3::zeros(), &(white_noise() * MAX_PREDICTION_TIME)),
        }
    }

    /// A robot that is assumed to have this velocity, with the uncertainty of an unknown one.
    pub(super) fn assumed(twist: Twist2) -> Self {
        Self { twist, ..Self::unknown(&PoseCovariance::zeros()) }
    }

    /// Covariance of the velocity, m/s, m/s, rad/s.
    pub(super) fn twist_covariance(&self) -> PoseCovariance {
        self.covariance.fixed_view::<3, 3>(3, 3).into()
    }

    /// Predicts the motion over some time.
    pub(super) fn predict(&self, seconds: f64) -> PredictedMotion {
        let is_known = seconds <= MAX_PREDICTION_TIME;
        let twist = if is_known { self.twist } else { Twist2::default() };
        let motion = twist.motion(seconds);
        // Errors of the pose are expressed in the frame of the new pose; an error of the heading also moves the position.
        let back = rotation(-motion.theta);
        let pose_transition = back * pose_jacobian(motion.translation());
        // An error of the angular velocity becomes one of the heading, which affects the path from its middle on.
        let twist_transition = rotation(-0.5 * motion.theta) * pose_jacobian(0.5 * motion.translation()) * seconds;
        let mut transition = Matrix6::identity();
        transition.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose_transition);
        transition.fixed_view_mut::<3, 3>(0, 3).copy_from(&twist_transition);
        // The process noise affects the heading later: for white noise 3/8 of the distance is left then.
        let (noise, lever_arm) = (white_noise(), pose_jacobian(0.375 * motion.translation()));
        let pose_noise = lever_arm * noise * lever_arm.transpose() * (seconds.powi(3) / 3.0);
        let added = blocks(&pose_noise, &(lever_arm * noise * (seconds.powi(2) / 2.0)), &(noise * seconds));
        let covariance = transition * self.covariance * transition.transpose() + added;
        let mut state = Self { twist, covariance };
        if !is_known {
            state = Self::unknown(&state.pose_covariance());
        }
        PredictedMotion { motion, state }
    }

    fn pose_covariance(&self) -> PoseCovariance {
        self.covariance.fixed_view::<3, 3>(0, 0).into()
    }
}

impl PredictedMotion {
    /// The motion and the covariance of its end, along the axes of its start.
    pub(super) fn prediction(&self) -> Prediction {
        Prediction { motion: self.motion, covariance: rotated(&self.state.pose_covariance(), self.motion.theta) }
    }

    /// The state updated by a measured `motion`. `covariance` is that of the pose given prediction and measurement together,
    /// along the axes of the motion's end.
    ///
    /// The velocity is updated by its correlation with the pose: the regression of the one on the other is that of the Kalman
    /// gain, whatever the source of the pose.
    pub(super) fn updated(&self, motion: &Pose2, covariance: &PoseCovariance) -> MotionState {
        let (pose, twist) = (self.state.pose_covariance(), self.state.twist_covariance());
        let Some(information) = pose.try_inverse() else { return self.state };
        let gain = self.state.covariance.fixed_view::<3, 3>(0, 3).transpose() * information;
        let error = self.motion.between(motion);
        let change = gain * Vector3::new(error.x, error.y, wrap_angle(error.theta));
        let Twist2 { vx, vy, omega } = self.state.twist;
        let known =
            blocks(covariance, &(covariance * gain.transpose()), &(twist - gain * (pose - covariance) * gain.transpose()));
        MotionState {
            twist: Twist2 { vx: vx + change.x, vy: vy + change.y, omega: omega + change.z },
            covariance: 0.5 * (known + known.transpose()), // symmetric in spite of rounding errors
        }
    }

    /// The state of a robot at a pose that it cannot have driven to: its velocity stays as predicted.
    pub(super) fn kidnapped(&self, covariance: &PoseCovariance) -> MotionState {
        let MotionState { twist, .. } = self.state;
        MotionState { twist, covariance: blocks(covariance, &Matrix3::zeros(), &self.state.twist_covariance()) }
    }
}

/// Spectral density of the process noise.
fn white_noise() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(ACCELERATION_NOISE, ACCELERATION_NOISE, ANGULAR_ACCELERATION_NOISE))
}

/// The covariance of pose and velocity, from its blocks.
fn blocks(pose: &Matrix3<f64>, cross: &Matrix3<f64>, twist: &Matrix3<f64>) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(pose);
    all.fixed_view_mut::<3, 3>(0, 3).copy_from(cross);
    all.fixed_view_mut::<3, 3>(3, 0).copy_from(&cross.transpose());
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(twist);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty::diagonal;

    /// The state after driving straight at `speed` for two seconds, measured exactly at `rate` Hz.
    fn after_driving(speed: f64, rate: u32) -> MotionState {
        let known = diagonal(0.003, 0.001);
        let mut motion = MotionState::unknown(&known);
        let seconds = f64::from(rate).recip();
        for _ in 0..2 * rate {
            let step = Pose2::new(speed * seconds, 0.0, 0.0);
            let predicted = motion.predict(seconds);
            let prior = predicted.state.pose_covariance().try_inverse().unwrap();
            let fused = (known.try_inverse().unwrap() + prior).try_inverse().unwrap();
            motion = predicted.updated(&step, &fused);
        }
        motion
    }

    #[test]
    fn the_velocity_is_estimated_at_any_rate() {
        for rate in [5, 20, 40, 200, 1000] {
            let Twist2 { vx, vy, omega } = after_driving(6.0, rate).twist;
            assert!((vx - 6.0).abs() < 0.05 && vy.abs() < 1e-9 && omega.abs() < 1e-9, "{rate} Hz: {vx} m/s");
        }
    }

    #[test]
    fn predictions_do_not_depend_on_the_number_of_steps() {
        let start = MotionState { twist: Twist2 { vx: 2.0, vy: 0.0, omega: 0.3 }, ..after_driving(2.0, 40) };
        let at_once = start.predict(0.1);
        let mut motion = start;
        for _ in 0..100 {
            motion = motion.predict(0.001).state;
        }
        let (once, often) = (at_once.state.pose_covariance(), motion.pose_covariance());
        assert!((once - often).norm() < 0.02 * once.norm(), "{once} {often}");
        assert!(motion.covariance.cholesky().is_some());
    }

    #[test]
    fn the_velocity_is_unknown_after_a_long_time() {
        let Prediction { motion, covariance } = after_driving(3.0, 40).predict(3.0).prediction();
        assert_eq!(motion, Pose2::IDENTITY);
        assert!(covariance.m11.sqrt() > 1.0);
    }

    #[test]
    fn a_kidnapped_robot_keeps_its_velocity() {
        let before = after_driving(3.0, 40);
        let after = before.predict(0.025).kidnapped(&diagonal(0.003, 0.001));
        assert_eq!(after.twist, before.twist);
        assert!(after.twist_covariance().m11 > before.twist_covariance().m11);
    }
}
