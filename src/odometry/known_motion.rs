//! What is known of the motion to a scan beforehand, and what its match makes of each source of that knowledge.

use super::answer::Found;
use super::attempt::{Attempt, Last};
use super::prediction::Prediction;
use super::registration::Disbelieved;
use super::{LaserOdometry, source_noise, uncertainty};
use crate::geometry::{Pose2, wrap_angle};
use crate::time::Stamp;

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
            let usually = last.motion.expect(seconds).prediction();
            said.doubted_by(&expected, &usually).and(&expected)
        };
        let known = said.map_or(expected, fused);
        self.sources.believe_imu(!self.noise.imu.is_disbelieved());
        let prediction = self.sources.with_heading(&known, last.stamp, stamp);
        Attempt { last: *last, prediction, expected, said, said_turn, awaits_odometry, base_from_laser: *base_from_laser }
    }

    fn count_disbelieved(&mut self, has_odometry: bool) {
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
