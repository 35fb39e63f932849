//! How the robot is expected to go on: a Kalman filter over the errors of its last pose and of its velocity (Kalman 1960), with white
//! noise as acceleration, so that what is expected after a time is the same whether scans come often or seldom (Bar-Shalom, Li and
//! Kirubarajan 2001, section 6.2).

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::prediction::Prediction;
use super::uncertainty::{turn, turned, way_by_heading};
use crate::geometry::{Pose2, PoseCovariance, Twist2, wrap_angle};

/// Spectral density of the acceleration, forward and to the left, m^2/s^3: a car's, which brakes by 8 m/s^2 for half a second ...
const ACCELERATION: f64 = 5.0;
/// ... and of the turn's, rad^2/s^3.
const TURN_ACCELERATION: f64 = 40.0;
/// After a longer time nothing is left of a velocity, s; of a robot that has not been seen to move, so long ago it stood.
const LONGEST: f64 = 1.0;

/// The velocity of the robot, and what is known of it together with its pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionState {
    /// Velocity of the base.
    pub(super) twist: Twist2,
    /// Covariance of the errors of pose and velocity, in the frame of the base: m, m, rad, m/s, m/s, rad/s.
    covariance: Matrix6<f64>,
}

/// Where the robot is expected to be some time later.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    /// From the last pose to this one, seen from the former.
    motion: Pose2,
    /// As it will be when nothing more is seen.
    state: MotionState,
}

impl MotionState {
    /// Of a robot of which nothing is known but that it cannot have sped up for longer than [`LONGEST`]. `covariance`: of its pose along
    /// the axes of the base.
    pub(super) fn unknown(covariance: &PoseCovariance) -> Self {
        Self { twist: Twist2::default(), covariance: blocks(covariance, &Matrix3::zeros(), &(white_noise() * LONGEST)) }
    }

    /// Of a robot that is supposed to move like this, though nothing is known of it.
    pub(super) fn supposed(twist: Twist2) -> Self {
        Self { twist, ..Self::unknown(&PoseCovariance::zeros()) }
    }

    /// Covariance of the velocity, m/s, m/s, rad/s.
    pub(super) fn twist_covariance(&self) -> PoseCovariance {
        self.covariance.fixed_view::<3, 3>(3, 3).into()
    }

    /// After some time.
    pub(super) fn expect(&self, seconds: f64) -> Expected {
        let is_known = seconds <= LONGEST;
        let twist = if is_known { self.twist } else { Twist2::default() };
        let motion = twist.motion(seconds);
        // Errors of the pose are seen from its end, where the way there leads elsewhere by an error of the heading before.
        let back = turn(-motion.theta);
        let by_pose = back * way_by_heading(motion.translation());
        // An error of the turn's rate becomes one of the heading on the way, and is felt from the middle of it on.
        let by_twist = turn(-0.5 * motion.theta) * way_by_heading(0.5 * motion.translation()) * seconds;
        let mut by_state = Matrix6::identity();
        by_state.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_pose);
        by_state.fixed_view_mut::<3, 3>(0, 3).copy_from(&by_twist);
        // What noise does to the heading, it does later: for white noise, 3/8 of the way is left then.
        let (noise, late) = (white_noise(), way_by_heading(0.375 * motion.translation()));
        let of_pose = late * noise * late.transpose() * (seconds.powi(3) / 3.0);
        let added = blocks(&of_pose, &(late * noise * (seconds.powi(2) / 2.0)), &(noise * seconds));
        let covariance = by_state * self.covariance * by_state.transpose() + added;
        let mut state = Self { twist, covariance };
        if !is_known {
            state = Self::unknown(&state.pose_covariance());
        }
        Expected { motion, state }
    }

    fn pose_covariance(&self) -> PoseCovariance {
        self.covariance.fixed_view::<3, 3>(0, 0).into()
    }
}

impl Expected {
    /// The motion, with the covariance of where it ends, along the axes of its start.
    pub(super) fn prediction(&self) -> Prediction {
        Prediction { motion: self.motion, covariance: turned(&self.state.pose_covariance(), self.motion.theta) }
    }

    /// The state where nothing was seen, or nothing that says how the robot came there.
    pub(super) fn unseen(&self) -> MotionState {
        self.state
    }

    /// The state when the robot was found to have moved by `motion`, `covariance` (along the axes of its end) being what is known of the pose then, from all that is known.
    ///
    /// What is learned of the pose is as much about the velocity as the two have to do with one another: the regression of the one on the
    /// other is that of the Kalman gain, whatever the pose was learned from.
    pub(super) fn found(&self, motion: &Pose2, covariance: &PoseCovariance) -> MotionState {
        let (pose, both, twist) = (self.state.pose_covariance(), self.cross_covariance(), self.state.twist_covariance());
        let Some(information) = pose.try_inverse() else { return self.state };
        let gain = both.transpose() * information;
        let error = self.motion.between(motion);
        let change = gain * Vector3::new(error.x, error.y, wrap_angle(error.theta));
        let Twist2 { vx, vy, omega } = self.state.twist;
        let known =
            blocks(covariance, &(covariance * gain.transpose()), &(twist - gain * (pose - covariance) * gain.transpose()));
        MotionState {
            twist: Twist2 { vx: vx + change.x, vy: vy + change.y, omega: omega + change.z },
            covariance: symmetric(&known),
        }
    }

    /// The state when the robot was found where it cannot have driven to: that says nothing of its velocity.
    pub(super) fn carried_off(&self, covariance: &PoseCovariance) -> MotionState {
        let MotionState { twist, .. } = self.state;
        MotionState { twist, covariance: blocks(covariance, &Matrix3::zeros(), &self.state.twist_covariance()) }
    }

    fn cross_covariance(&self) -> Matrix3<f64> {
        self.state.covariance.fixed_view::<3, 3>(0, 3).into()
    }
}

/// Spectral density of the acceleration.
fn white_noise() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(ACCELERATION, ACCELERATION, TURN_ACCELERATION))
}

/// The covariance of pose and velocity, from its blocks.
fn blocks(pose: &Matrix3<f64>, both: &Matrix3<f64>, twist: &Matrix3<f64>) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(pose);
    all.fixed_view_mut::<3, 3>(0, 3).copy_from(both);
    all.fixed_view_mut::<3, 3>(3, 0).copy_from(&both.transpose());
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(twist);
    all
}

/// Without what rounding has made of symmetry.
fn symmetric(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    0.5 * (matrix + matrix.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty::diagonal;

    /// What is left of a robot that drives straight on at `speed`, seen `rate` times a second for two seconds, exactly.
    fn seen(speed: f64, rate: u32) -> MotionState {
        let known = diagonal(0.003, 0.001);
        let mut motion = MotionState::unknown(&known);
        let seconds = f64::from(rate).recip();
        for _ in 0..2 * rate {
            let step = Pose2::new(speed * seconds, 0.0, 0.0);
            let expected = motion.expect(seconds);
            let prior = expected.state.pose_covariance().try_inverse().unwrap();
            let both = (known.try_inverse().unwrap() + prior).try_inverse().unwrap();
            motion = expected.found(&step, &both);
        }
        motion
    }

    #[test]
    fn a_velocity_is_learned_at_any_rate() {
        for rate in [5, 20, 40, 200, 1000] {
            let Twist2 { vx, vy, omega } = seen(6.0, rate).twist;
            assert!((vx - 6.0).abs() < 0.05 && vy.abs() < 1e-9 && omega.abs() < 1e-9, "{rate} Hz: {vx} m/s");
        }
    }

    #[test]
    fn what_is_expected_later_does_not_depend_on_how_often_it_was_asked() {
        let start = MotionState { twist: Twist2 { vx: 2.0, vy: 0.0, omega: 0.3 }, ..seen(2.0, 40) };
        let at_once = start.expect(0.1);
        let mut motion = start;
        for _ in 0..100 {
            motion = motion.expect(0.001).unseen();
        }
        let (once, often) = (at_once.state.pose_covariance(), motion.pose_covariance());
        assert!((once - often).norm() < 0.02 * once.norm(), "{once} {often}");
        assert!(motion.covariance.cholesky().is_some());
    }

    #[test]
    fn nothing_is_left_of_a_velocity_after_a_long_time() {
        let Prediction { motion, covariance } = seen(3.0, 40).expect(3.0).prediction();
        assert_eq!(motion, Pose2::IDENTITY);
        assert!(covariance.m11.sqrt() > 1.0);
    }

    #[test]
    fn a_robot_that_was_carried_off_has_the_velocity_it_had() {
        let before = seen(3.0, 40);
        let after = before.expect(0.025).carried_off(&diagonal(0.003, 0.001));
        assert_eq!(after.twist, before.twist);
        assert!(after.twist_covariance().m11 > before.twist_covariance().m11);
    }
}
