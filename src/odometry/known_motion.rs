//! Predicts the motion to a scan, and learns from its match how accurate each source of the prediction is.

use super::match_problem::{MatchProblem, PreviousEstimate};
use super::pose_estimate::MatchResult;
use super::prediction::Prediction;
use super::registration::RejectedSources;
use super::{LaserOdometry, source_noise, uncertainty};
use crate::geometry::{Pose2, wrap_angle};
use crate::time::Stamp;

impl LaserOdometry {
    /// Predicts the pose of a scan taken at `stamp`. Fuses constant velocity with odometry, each weighted by how accurate it has
    /// been lately.
    pub(super) fn match_problem(&mut self, previous: &PreviousEstimate, stamp: Stamp, base_from_laser: &Pose2) -> MatchProblem {
        let awaits_odometry = self.awaits_odometry(stamp);
        self.odometry_wait_timed_out = self.sources.is_behind(stamp);
        let constant_velocity = previous.motion.predict(stamp.seconds_since(previous.stamp)).prediction();
        let odometry = self.sources.motion_without_imu(previous.stamp, stamp);
        // If stamps jitter, the scan period may be longer than the stamps suggest.
        let seconds = stamp.seconds_since(previous.stamp).max(self.typical_period);
        let odometry = odometry.map(|motion| Prediction { motion, covariance: uncertainty::wheel_covariance(&motion, seconds) });
        let imu_rotation = self.sources.imu_rotation(previous.stamp, stamp);
        self.count_rejected(odometry.is_some(), imu_rotation.is_some());
        // Without odometry there is nothing better than the velocity, even if it was wrong: a kidnapped robot drives on. So only
        // the fused velocity gets the learned noise.
        let fused = |odometry: Prediction| {
            let (odometry, constant_velocity) =
                (odometry.with_noise(self.noise.odometry), constant_velocity.with_noise(self.noise.velocity));
            let typical = previous.motion.predict(seconds).prediction();
            odometry.checked_against(&constant_velocity, &typical).fused_with(&constant_velocity)
        };
        let prediction = odometry.map_or(constant_velocity, fused);
        self.sources.set_imu_rejected(self.noise.imu.is_rejected());
        let prediction = self.sources.with_imu_heading(&prediction, previous.stamp, stamp);
        MatchProblem {
            previous: *previous,
            prediction,
            constant_velocity,
            odometry,
            imu_rotation,
            awaits_odometry,
            base_from_laser: *base_from_laser,
        }
    }

    fn count_rejected(&mut self, has_odometry: bool, has_imu: bool) {
        let RejectedSources { odometry, imu } = self.noise.rejected_sources();
        self.counters.without_odometry += u64::from(!has_odometry);
        self.counters.odometry_rejected += u64::from(has_odometry && odometry);
        self.counters.imu_rejected += u64::from(has_imu && imu);
    }

    /// Updates the noise of each source by a finished match; an unmatched scan has no effect.
    pub(super) fn update_noise(&mut self, problem: &MatchProblem, result: &MatchResult, stamp: Stamp) {
        let Ok(estimate) = &result.estimate else { return };
        self.counters.odometry_contradicted += u64::from(estimate.contradicts_odometry && !self.noise.odometry.is_rejected());
        self.sources.learn_lag(stamp, self.map_from_odom.inverse() * estimate.map_from_base);
        let motion = problem.previous.map_from_base.between(&estimate.map_from_base);
        self.noise.velocity.update(source_noise::normalized_innovation(&problem.constant_velocity, &motion));
        if let Some(odometry) = &problem.odometry {
            self.noise.odometry.update(source_noise::normalized_innovation(odometry, &motion));
        }
        if let Some((rotation, deviation)) = problem.imu_rotation {
            self.noise.imu.update(wrap_angle(motion.theta - rotation).abs() / deviation);
        }
    }
}
