//! Sources of the robot's motion besides its scans.
//!
//! The best available source is used: transforms of another node, then wheel odometry, then a velocity, the last two with the
//! rotation of an IMU. Without any the robot is assumed to move at constant velocity.

use crate::geometry::{Pose2, PoseCovariance, Twist2, wrap_angle};
use crate::time::Stamp;

use super::heading::ImuHeading;
use super::lag::LagEstimator;
use super::prediction::Prediction;
use super::wheel::{WheelEvent, WheelOdometry, WheelSample};

/// Rotations that differ by more standard deviations than this contradict each other.
const CONTRADICTION_GATE: f64 = 5.0;
/// Maximum age of a velocity that is used for a scan, s.
const MAX_VELOCITY_AGE: f64 = 0.5;
/// Standard deviation of an IMU's rotation: constant part, rad.
const IMU_ROTATION_ERROR: f64 = 0.005;
/// Standard deviation of an IMU's rotation: fraction of the rotation.
const IMU_SCALE_ERROR: f64 = 0.02;

/// All sources of the robot's motion.
#[derive(Clone, Debug, Default)]
pub struct MotionSources {
    /// Poses of the base by another node's transforms.
    pub(super) transforms: WheelOdometry,
    pub(super) heading: ImuHeading,
    /// The matches contradict the IMU: its rotations are not used.
    pub(super) imu_rejected: bool,
    wheels: WheelOdometry,
    wheel_lag: LagEstimator,
    /// With the stamp of the latest scan before it arrived: velocities have no stamp of their own.
    pub(super) velocity: Option<(Stamp, Twist2)>,
}

impl MotionSources {
    /// Adds a message of wheel odometry.
    pub fn push(&mut self, sample: WheelSample) -> WheelEvent {
        self.wheels.push(sample)
    }

    /// Whether a source that reports the motion until `stamp` is expected but has not arrived yet.
    pub fn is_behind(&self, stamp: Stamp) -> bool {
        self.wheels.is_behind(self.wheel_time(stamp)) || self.transforms.is_due(stamp) || self.heading.is_due(stamp)
    }

    /// The stamp of the latest message of wheel odometry.
    pub fn last_wheel_stamp(&self) -> Option<Stamp> {
        self.wheels.last_stamp()
    }

    /// Pose of the base by wheel odometry when its own clock reads `stamp`.
    pub fn wheel_pose(&self, stamp: Stamp) -> Option<Pose2> {
        self.wheels.pose_at(stamp)
    }

    /// Estimated lag of scans behind the wheel odometry, s.
    pub fn wheel_lag(&self) -> f64 {
        self.wheel_lag.seconds()
    }

    /// Updates the lag of the wheels by a matched pose of the base, in a frame in which it does not jump.
    pub fn learn_lag(&mut self, stamp: Stamp, odom_from_base: Pose2) {
        self.wheel_lag.learn(stamp, odom_from_base, &self.wheels);
    }

    /// The wheels' clock when a scan of this stamp was taken.
    fn wheel_time(&self, stamp: Stamp) -> Stamp {
        stamp.offset_by(-self.wheel_lag.seconds())
    }

    /// The motion of the base from one time to another, in the frame of the first; `None` if no source covers it.
    pub fn motion(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        let motion = self.motion_without_imu(from, to)?;
        Some(self.accepted_imu_rotation(from, to).map_or(motion, |(rotation, _)| with_rotation(&motion, rotation)))
    }

    /// The motion by all sources but the IMU.
    pub fn motion_without_imu(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        let wheel_motion =
            || self.wheels.motion(self.wheel_time(from), self.wheel_time(to)).or_else(|| self.velocity_motion(from, to));
        self.transforms.motion(from, to).or_else(wheel_motion)
    }

    /// The IMU's rotation from one time to another, rad, and its standard deviation, rad; even if it is rejected.
    pub fn imu_rotation(&self, from: Stamp, to: Stamp) -> Option<(f64, f64)> {
        let rotation = self.heading.rotation(from, to)?;
        Some((rotation, IMU_ROTATION_ERROR + IMU_SCALE_ERROR * rotation.abs()))
    }

    /// The IMU's rotation, unless it is rejected or another node's transforms cover the motion.
    fn accepted_imu_rotation(&self, from: Stamp, to: Stamp) -> Option<(f64, f64)> {
        let is_used = !self.imu_rejected && self.transforms.motion(from, to).is_none();
        if is_used { self.imu_rotation(from, to) } else { None }
    }

    fn velocity_motion(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        let (after, twist) = self.velocity?;
        (to.seconds_since(after) <= MAX_VELOCITY_AGE).then(|| twist.motion(to.seconds_since(from)))
    }

    /// A prediction by other sources with the IMU's rotation, if that is more certain. If the two contradict each other, one of
    /// them is wrong, and their difference becomes the heading's standard deviation.
    pub(super) fn with_imu_heading(&self, known: &Prediction, from: Stamp, to: Stamp) -> Prediction {
        let Some((rotation, deviation)) = self.accepted_imu_rotation(from, to) else { return *known };
        let Prediction { motion, covariance } = *known;
        let difference = wrap_angle(rotation - motion.theta);
        if difference.abs() > CONTRADICTION_GATE * covariance.m33.sqrt().hypot(deviation) {
            return Prediction { motion, covariance: with_heading_variance(&covariance, difference * difference) };
        }
        let variance = covariance.m33.min(deviation * deviation);
        Prediction { motion: with_rotation(&motion, rotation), covariance: with_heading_variance(&covariance, variance) }
    }
}

/// The covariance with another variance of the heading, rad^2. The regression of the position on the heading is kept.
fn with_heading_variance(covariance: &PoseCovariance, variance: f64) -> PoseCovariance {
    if covariance.m33 <= 0.0 {
        return *covariance;
    }
    let by_heading = covariance.column(2) / covariance.m33;
    covariance + by_heading * by_heading.transpose() * (variance - covariance.m33)
}

/// The motion with the same arc length but another rotation.
fn with_rotation(motion: &Pose2, rotation: f64) -> Pose2 {
    Twist2 { omega: rotation, ..Twist2::from_motion(motion, 1.0) }.motion(1.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::odometry::heading::HeadingReading;
    use crate::odometry::uncertainty;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    fn sample(seconds: f64, pose: Pose2) -> WheelSample {
        WheelSample { stamp: at(seconds), pose, twist: None }
    }

    fn motion(sources: &MotionSources) -> Pose2 {
        sources.motion(at(0.0), at(0.1)).unwrap()
    }

    #[test]
    fn the_best_available_source_is_used() {
        let mut sources = MotionSources::default();
        assert_eq!(sources.motion(at(0.0), at(0.1)), None);
        sources.velocity = Some((at(0.0), Twist2 { vx: 1.0, vy: 0.0, omega: 0.0 }));
        assert_eq!(motion(&sources), Pose2::new(0.1, 0.0, 0.0));
        assert_eq!(sources.motion(at(0.5), at(0.6)), None, "an old velocity");
        for seconds in [0.0, 0.1] {
            sources.push(sample(seconds, Pose2::new(2.0 * seconds, 0.0, 0.0)));
        }
        assert_eq!(motion(&sources), Pose2::new(0.2, 0.0, 0.0));
        for (seconds, yaw) in [(0.0, 1.0), (0.1, 1.3)] {
            sources.heading.push(HeadingReading { stamp: at(seconds), yaw: Some(yaw), rate: 3.0 });
        }
        let rotated = motion(&sources);
        assert!((rotated.theta - 0.3).abs() < 1e-9 && rotated.y > 0.02, "the arc of the wheels bends: {rotated:?}");
        assert!((rotated.distance() - 0.2).abs() < 1e-3);
        for seconds in [0.0, 0.1] {
            sources.transforms.push(sample(seconds, Pose2::new(5.0 * seconds, 0.0, 0.0)));
        }
        assert_eq!(motion(&sources), Pose2::new(0.5, 0.0, 0.0));
    }

    #[test]
    fn an_imu_alone_rotates_the_prediction_and_reduces_its_variance() {
        let mut sources = MotionSources::default();
        let covariance = uncertainty::diagonal(0.035, 0.11);
        let straight = Prediction { motion: Pose2::new(0.1, 0.0, 0.0), covariance };
        let unchanged = sources.with_imu_heading(&straight, at(0.0), at(0.1));
        assert_eq!((unchanged.motion, unchanged.covariance), (straight.motion, straight.covariance));
        for (seconds, yaw) in [(0.0, 0.0), (0.1, 0.2)] {
            sources.heading.push(HeadingReading { stamp: at(seconds), yaw: Some(yaw), rate: 2.0 });
        }
        let Prediction { motion: rotated, covariance: known } = sources.with_imu_heading(&straight, at(0.0), at(0.1));
        assert!((rotated.theta - 0.2).abs() < 1e-9 && known[(2, 2)] < 0.1 * covariance[(2, 2)]);
        assert_eq!(known[(0, 0)].to_bits(), covariance[(0, 0)].to_bits());
    }

    #[test]
    fn any_heading_variance_gives_a_valid_covariance() {
        let heading_moves_the_position = Vector3::new(0.0, 0.1, 0.4);
        let covariance = uncertainty::diagonal(0.01, 0.01) + heading_moves_the_position * heading_moves_the_position.transpose();
        for deviation in [1e-4, 0.02, 0.4, 3.0] {
            let known = with_heading_variance(&covariance, deviation * deviation);
            assert!((known.m33 - deviation * deviation).abs() < 1e-12 && known.cholesky().is_some(), "{deviation}: {known}");
            assert!((known.m23 / known.m33 - covariance.m23 / covariance.m33).abs() < 1e-9);
        }
        let exact = uncertainty::diagonal(0.0, 0.0);
        assert_eq!(with_heading_variance(&exact, 0.1), exact);
    }

    #[test]
    fn scans_wait_for_active_sources_only() {
        let mut sources = MotionSources::default();
        sources.heading.push(HeadingReading { stamp: at(0.0), yaw: None, rate: 0.1 });
        assert_eq!([0.01, 0.2, 2.0].map(|seconds| sources.is_behind(at(seconds))), [false, true, false]);
    }
}
