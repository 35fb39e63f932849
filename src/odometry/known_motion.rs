//! Takes the messages of all sources of motion, predicts the motion to a scan, and learns from its match how accurate each source of the prediction is.

use super::heading::HeadingReading;
use super::match_problem::MatchProblem;
use super::match_scan::MatchResult;
use super::prediction::Prediction;
use super::previous_estimate::PreviousEstimate;
use super::registration::RejectedSources;
use super::wheel::{WheelEvent, WheelSample};
use super::{LaserOdometry, source_noise};
use crate::geometry::{Pose2, Twist2, wrap_angle};
use crate::time::Stamp;

impl LaserOdometry {
    /// Adds a message of wheel odometry.
    pub fn add_wheel_sample(&mut self, sample: WheelSample) {
        self.odometry_wait_timed_out = false;
        match self.sources.push(sample) {
            WheelEvent::Appended => {}
            WheelEvent::TimeJump { is_continuous } => self.stamps.odometry_went_back(is_continuous),
            WheelEvent::Duplicate => self.counters.duplicate_odometry += 1,
            WheelEvent::Reset => self.counters.odometry_resets += 1,
        }
    }

    /// Adds an IMU reading.
    pub fn add_imu_reading(&mut self, reading: HeadingReading) {
        self.odometry_wait_timed_out = false;
        self.sources.heading.push(reading);
    }

    /// Adds the pose of the base by another node's transforms.
    pub fn add_transform_sample(&mut self, sample: WheelSample) {
        self.odometry_wait_timed_out = false;
        self.sources.transforms.push(sample);
    }

    /// Sets the current velocity of the base.
    pub fn set_velocity(&mut self, twist: Twist2) {
        if let Some(previous) = self.previous {
            self.sources.velocity = Some((previous.stamp, twist));
        }
    }

    /// Whether a scan of this stamp should wait for the next odometry message.
    pub fn awaits_odometry(&self, stamp: Stamp) -> bool {
        !self.odometry_wait_timed_out && self.sources.is_behind(stamp)
    }

    /// Predicts the pose of a scan taken at `stamp`. Fuses constant velocity with odometry, each weighted by how accurate it has
    /// been lately.
    pub(super) fn match_problem(&mut self, previous: &PreviousEstimate, stamp: Stamp, base_from_laser: &Pose2) -> MatchProblem {
        let awaits_odometry = self.awaits_odometry(stamp);
        self.odometry_wait_timed_out = self.sources.is_behind(stamp);
        let constant_velocity = previous.motion.predict(stamp.seconds_since(previous.stamp)).prediction();
        // If stamps jitter, the scan period may be longer than the stamps suggest.
        let seconds = stamp.seconds_since(previous.stamp).max(self.typical_period);
        let odometry = self.sources.motion_without_imu(previous.stamp, stamp);
        let odometry = odometry.map(|motion| Prediction::by_wheels(motion, seconds));
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
        self.sources.imu_rejected = self.noise.imu.is_rejected();
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
