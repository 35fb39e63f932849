//! A scan that is to be matched: what is known of its pose beforehand.

use super::answer::Found;
use super::motion_state::MotionState;
use super::placement::Placement;
use super::prediction::Prediction;
use super::registration::Disbelieved;
use super::{LaserOdometry, source_noise, uncertainty};
use crate::geometry::{Pose2, PoseCovariance, Twist2, wrap_angle};
use crate::matching::{Prior, SearchWindow};
use crate::time::Stamp;

/// The agreement of scans varies by this from one to the next.
pub(super) const USUAL_VARIATION: f64 = 0.05;
/// To either side of a predicted turn so much of it is searched.
const SEARCHED_PART_OF_TURN: f64 = 1.2;

/// The last answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Last {
    pub(super) stamp: Stamp,
    pub(super) map_from_base: Pose2,
    pub(super) map_from_laser: Pose2,
    pub(super) covariance: PoseCovariance,
    /// The same seen from the keyframe that it was matched to, along the axes of the base.
    pub(super) covariance_to_keyframe: PoseCovariance,
    /// The velocity that led from the answer before to this one.
    pub(super) seen_twist: Twist2,
    /// The same, but of the last step that a robot can have driven. Sweeps are straightened by it: the filter's, which is of the step's
    /// end, overshoots, and a sweep that was straightened by too much makes it overshoot again.
    pub(super) mean_twist: Twist2,
    /// The velocity that is believed in, and what is known of it.
    pub(super) motion: MotionState,
    /// A scan after it could not be matched, and has changed nothing of what the next one starts from.
    pub(super) passed_over: bool,
}

impl Last {
    /// The place of its laser on the base.
    pub(super) fn base_from_laser(&self) -> Pose2 {
        self.map_from_base.between(&self.map_from_laser)
    }
}

/// A scan to be matched.
#[derive(Clone, Copy)]
pub(super) struct Attempt {
    /// The answer before.
    pub(super) last: Last,
    /// Motion of the base since then.
    pub(super) prediction: Prediction,
    /// That motion if the base has gone on as it did.
    pub(super) expected: Prediction,
    /// What odometry says of it, believed or not.
    pub(super) said: Option<Prediction>,
    /// What the IMU says of its turn, believed or not, rad, and the standard deviation.
    pub(super) said_turn: Option<(f64, f64)>,
    /// Odometry that says more of that motion is on its way.
    pub(super) awaits_odometry: bool,
    /// Place of the laser on the base.
    pub(super) base_from_laser: Pose2,
}

impl Attempt {
    /// The predicted pose of the laser in the keyframe's frame. `of_last`: covariance of the last pose there, along the axes of the base.
    pub(super) fn prior(&self, keyframe: &Placement, of_last: &PoseCovariance) -> Prior {
        let none = PoseCovariance::zeros();
        let keyframe_from_last = keyframe.map_from_laser.between(&self.last.map_from_base);
        let Prediction { motion, covariance } = &self.prediction;
        let keyframe_from_base = keyframe_from_last * *motion;
        let of_last = uncertainty::turned(of_last, keyframe_from_last.theta);
        let of_base = uncertainty::compound(&keyframe_from_last, &of_last, motion, covariance);
        Prior {
            pose: keyframe_from_base * self.base_from_laser,
            covariance: uncertainty::compound(&keyframe_from_base, &of_base, &self.base_from_laser, &none),
        }
    }

    /// Where to search, and when: the more the robot has turned, the less is known of how far. Where scans never agree as in a room,
    /// outdoors, less than usual is a sign.
    pub(super) fn window(&self, usual_agreement: f64) -> SearchWindow {
        let (turn, window) = (self.prediction.motion.theta.abs(), SearchWindow::default());
        let less_than_usual = (usual_agreement - USUAL_VARIATION).min(window.doubtful_agreement);
        SearchWindow {
            angle: window.angle.max(SEARCHED_PART_OF_TURN * turn),
            doubtful_agreement: if turn > window.angle { f64::INFINITY } else { less_than_usual },
            ..window
        }
    }

    /// Where the base should be on the map, and how well that is known.
    pub(super) fn predicted_base(&self) -> (Pose2, PoseCovariance) {
        let (last, Prediction { motion, covariance }) = (&self.last, &self.prediction);
        (last.map_from_base * *motion, uncertainty::compound(&last.map_from_base, &last.covariance, motion, covariance))
    }

    /// Where the laser should be.
    pub(super) fn predicted_laser(&self) -> Pose2 {
        self.last.map_from_base * self.prediction.motion * self.base_from_laser
    }
}

impl LaserOdometry {
    /// What is known of the pose of a scan taken at `stamp`: the base has gone on as it did, and moved as the odometry says, each as far
    /// as it has been right lately.
    pub(super) fn attempt(&mut self, last: &Last, stamp: Stamp, base_from_laser: &Pose2) -> Attempt {
        let awaits_odometry = self.awaits_odometry(stamp);
        self.waited_in_vain = self.sources.is_behind(stamp);
        let expected = last.motion.expect(stamp.seconds_since(last.stamp)).prediction();
        let said = self.sources.motion_without_imu(last.stamp, stamp);
        // Where stamps jitter, less time has passed by them than it took.
        let seconds = stamp.seconds_since(last.stamp).max(self.usual_period);
        let said = said.map(|motion| Prediction { motion, covariance: uncertainty::of_wheels(&motion, seconds) });
        let said_turn = self.sources.turn_by_imu(last.stamp, stamp);
        self.count_disbelieved(said.is_some());
        // Where nothing else is known, a velocity that was wrong is no worse than before: a robot that was carried off drives on.
        let fused = |said: Prediction| {
            let (said, expected) = (said.with_noise(self.noise.odometry), expected.with_noise(self.noise.velocity));
            let usually = last.motion.expect(self.usual_period.max(stamp.seconds_since(last.stamp))).prediction();
            said.doubted_by(&expected, &usually).and(&expected)
        };
        let known = said.map_or(expected, fused);
        self.sources.believe_imu(!self.noise.imu.is_disbelieved());
        let prediction = self.sources.with_heading(&known, last.stamp, stamp);
        Attempt { last: *last, prediction, expected, said, said_turn, awaits_odometry, base_from_laser: *base_from_laser }
    }

    pub(super) fn count_disbelieved(&mut self, has_odometry: bool) {
        let Disbelieved { odometry, imu } = self.noise.disbelieved();
        self.counters.without_odometry += u64::from(!has_odometry);
        self.counters.odometry_disbelieved += u64::from(has_odometry && odometry);
        self.counters.imu_disbelieved += u64::from(imu);
    }

    /// What a match that is done makes of what each source said; a scan that was not matched says nothing.
    pub(super) fn judge_sources(&mut self, attempt: &Attempt, found: &Found, stamp: Stamp) {
        let Ok(answer) = &found.answer else { return };
        self.counters.odometry_contradicted += u64::from(answer.contradicts_odometry && !self.noise.odometry.is_disbelieved());
        self.sources.learn_lag(stamp, self.map_from_odom.inverse() * answer.map_from_base);
        let motion = attempt.last.map_from_base.between(&answer.map_from_base);
        self.noise.velocity.judge(source_noise::deviation(&attempt.expected, &motion));
        if let Some(said) = &attempt.said {
            self.noise.odometry.judge(source_noise::deviation(said, &motion));
        }
        if let Some((turn, deviation)) = attempt.said_turn {
            self.noise.imu.judge(wrap_angle(motion.theta - turn).abs() / deviation);
        }
    }
}
