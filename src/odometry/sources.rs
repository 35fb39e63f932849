//! What is known of the robot's motion besides its scans, from several sources at once.
//!
//! The better one goes first: transforms of another node, the heading of an IMU, wheel odometry, a velocity. Where there is none,
//! the robot is taken to go on as it did.

use crate::geometry::{Pose2, PoseCovariance, Twist2, wrap_angle};
use crate::time::Stamp;

use super::heading::{Heading, HeadingReading};
use super::lag::Lag;
use super::prediction::Prediction;
use super::wheel::{WheelEvent, WheelOdometry, WheelSample};

/// A turn this many standard deviations from another contradicts it.
const CONTRADICTING: f64 = 5.0;
/// A velocity that is older than this says nothing about a scan, s.
const OLDEST_VELOCITY: f64 = 0.5;
/// Standard deviation of an IMU's turn: so much, rad, ...
const HEADING_ERROR: f64 = 0.005;
/// ... and this part of the turn.
const HEADING_SCALE_ERROR: f64 = 0.02;

/// All sources of the robot's motion.
#[derive(Clone, Debug, Default)]
pub struct MotionSources {
    transforms: WheelOdometry,
    heading: Heading,
    /// The matches contradict the IMU: its turns are not used.
    heading_disbelieved: bool,
    wheels: WheelOdometry,
    wheel_lag: Lag,
    /// With the stamp of the last scan before it came: velocities have none of their own.
    velocity: Option<(Stamp, Twist2)>,
}

impl MotionSources {
    /// Where another node's transforms say the base is.
    pub fn push_transform(&mut self, sample: WheelSample) -> WheelEvent {
        self.transforms.push(sample)
    }

    /// A reading of the IMU.
    pub fn push_heading(&mut self, reading: HeadingReading) {
        self.heading.push(reading);
    }

    /// A message of wheel odometry.
    pub fn push(&mut self, sample: WheelSample) -> WheelEvent {
        self.wheels.push(sample)
    }

    /// The robot moves like this, from the scan of this stamp on.
    pub fn set_velocity(&mut self, after: Stamp, twist: Twist2) {
        self.velocity = Some((after, twist));
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Whether something comes that says where the base is at `stamp`, and has not come yet.
    pub fn is_behind(&self, stamp: Stamp) -> bool {
        self.wheels.is_behind(self.by_wheel_clock(stamp)) || self.transforms.is_due(stamp) || self.heading.is_due(stamp)
    }

    /// The stamp of the last message of wheel odometry.
    pub fn last_wheel_stamp(&self) -> Option<Stamp> {
        self.wheels.last_stamp()
    }

    /// Where wheel odometry says that the base is when its own clock says `stamp`.
    pub fn wheel_pose(&self, stamp: Stamp) -> Option<Pose2> {
        self.wheels.pose_at(stamp)
    }

    /// A scan shows where the wheels had the robot so long before its stamp, s.
    pub fn wheel_lag(&self) -> f64 {
        self.wheel_lag.seconds()
    }

    /// Takes where a match has found the base, in a frame in which it does not jump: the wheels' lag is learned by it.
    pub fn learn_lag(&mut self, stamp: Stamp, odom_from_base: Pose2) {
        self.wheel_lag.learn(stamp, odom_from_base, &self.wheels);
    }

    /// What the wheels' clock said when a scan of this stamp was taken.
    fn by_wheel_clock(&self, stamp: Stamp) -> Stamp {
        stamp.offset_by(-self.wheel_lag.seconds())
    }

    /// The motion of the base from one time to another, seen from the first; `None` where nothing covers it.
    pub fn motion(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        let motion = self.motion_without_imu(from, to)?;
        Some(self.believed_turn(from, to).map_or(motion, |(turn, _)| with_turn(&motion, turn)))
    }

    /// The same by all but the IMU.
    pub fn motion_without_imu(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        let by_wheels =
            || self.wheels.motion(self.by_wheel_clock(from), self.by_wheel_clock(to)).or_else(|| self.by_velocity(from, to));
        self.transforms.motion(from, to).or_else(by_wheels)
    }

    /// What the IMU says of the turn from one time to another, believed or not, rad, and its standard deviation.
    pub fn turn_by_imu(&self, from: Stamp, to: Stamp) -> Option<(f64, f64)> {
        let turn = self.heading.turn(from, to)?;
        Some((turn, HEADING_ERROR + HEADING_SCALE_ERROR * turn.abs()))
    }

    /// Whether to use the IMU's turns.
    pub fn believe_imu(&mut self, believed: bool) {
        self.heading_disbelieved = !believed;
    }

    /// The same where it is believed, and no other node's transforms say more.
    fn believed_turn(&self, from: Stamp, to: Stamp) -> Option<(f64, f64)> {
        let is_heard = !self.heading_disbelieved && self.transforms.motion(from, to).is_none();
        if is_heard { self.turn_by_imu(from, to) } else { None }
    }

    fn by_velocity(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        let (after, twist) = self.velocity?;
        (to.seconds_since(after) <= OLDEST_VELOCITY).then(|| twist.motion(to.seconds_since(from)))
    }

    /// A motion that was predicted some other way, with the IMU's turn where that is known better. Where the two contradict one another,
    /// one of them is wrong, and the heading is known no better than that.
    pub(super) fn with_heading(&self, known: &Prediction, from: Stamp, to: Stamp) -> Prediction {
        let Some((turn, deviation)) = self.believed_turn(from, to) else { return *known };
        let Prediction { motion, covariance } = *known;
        let difference = wrap_angle(turn - motion.theta);
        if difference.abs() > CONTRADICTING * covariance.m33.sqrt().hypot(deviation) {
            return Prediction { motion, covariance: with_heading_variance(&covariance, difference * difference) };
        }
        let variance = covariance.m33.min(deviation * deviation);
        Prediction { motion: with_turn(&motion, turn), covariance: with_heading_variance(&covariance, variance) }
    }
}

/// The covariance when the heading's variance is found to be another one, rad^2: what the position has to do with the heading stays, by
/// its regression on that.
fn with_heading_variance(covariance: &PoseCovariance, variance: f64) -> PoseCovariance {
    if covariance.m33 <= 0.0 {
        return *covariance;
    }
    let by_heading = covariance.column(2) / covariance.m33;
    covariance + by_heading * by_heading.transpose() * (variance - covariance.m33)
}

/// The motion of the same way but another turn: the arc bends more or less.
fn with_turn(motion: &Pose2, turn: f64) -> Pose2 {
    Twist2 { omega: turn, ..Twist2::of_motion(motion, 1.0) }.motion(1.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
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
    fn the_better_source_goes_first() {
        let mut sources = MotionSources::default();
        assert_eq!(sources.motion(at(0.0), at(0.1)), None);
        sources.set_velocity(at(0.0), Twist2 { vx: 1.0, vy: 0.0, omega: 0.0 });
        assert_eq!(motion(&sources), Pose2::new(0.1, 0.0, 0.0));
        assert_eq!(sources.motion(at(0.5), at(0.6)), None, "an old velocity");
        for seconds in [0.0, 0.1] {
            sources.push(sample(seconds, Pose2::new(2.0 * seconds, 0.0, 0.0)));
        }
        assert_eq!(motion(&sources), Pose2::new(0.2, 0.0, 0.0));
        for (seconds, yaw) in [(0.0, 1.0), (0.1, 1.3)] {
            sources.push_heading(HeadingReading { stamp: at(seconds), yaw: Some(yaw), rate: 3.0 });
        }
        let turned = motion(&sources);
        assert!((turned.theta - 0.3).abs() < 1e-9 && turned.y > 0.02, "the way of the wheels bends: {turned:?}");
        assert!((turned.distance() - 0.2).abs() < 1e-3);
        for seconds in [0.0, 0.1] {
            sources.push_transform(sample(seconds, Pose2::new(5.0 * seconds, 0.0, 0.0)));
        }
        assert_eq!(motion(&sources), Pose2::new(0.5, 0.0, 0.0));
    }

    #[test]
    fn an_imu_alone_turns_what_was_predicted_and_says_how_well() {
        let mut sources = MotionSources::default();
        let covariance = uncertainty::diagonal(0.035, 0.11);
        let straight = Prediction { motion: Pose2::new(0.1, 0.0, 0.0), covariance };
        let unturned = sources.with_heading(&straight, at(0.0), at(0.1));
        assert_eq!((unturned.motion, unturned.covariance), (straight.motion, straight.covariance));
        for (seconds, yaw) in [(0.0, 0.0), (0.1, 0.2)] {
            sources.push_heading(HeadingReading { stamp: at(seconds), yaw: Some(yaw), rate: 2.0 });
        }
        let Prediction { motion: turned, covariance: known } = sources.with_heading(&straight, at(0.0), at(0.1));
        assert!((turned.theta - 0.2).abs() < 1e-9 && known[(2, 2)] < 0.1 * covariance[(2, 2)]);
        assert_eq!(known[(0, 0)].to_bits(), covariance[(0, 0)].to_bits());
    }

    #[test]
    fn whatever_an_imu_says_of_the_heading_the_covariance_is_one() {
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
    fn scans_wait_for_what_comes_but_not_for_what_has_stopped_coming() {
        let mut sources = MotionSources::default();
        sources.push_heading(HeadingReading { stamp: at(0.0), yaw: None, rate: 0.1 });
        assert_eq!([0.01, 0.2, 2.0].map(|seconds| sources.is_behind(at(seconds))), [false, true, false]);
    }
}
