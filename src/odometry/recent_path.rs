//! The latest seconds of the path, to compare matches with odometry over more than one step.
//!
//! A match that follows moving people is off by little in each step, and keyframes taken meanwhile hide the error from matches to
//! them. Over a second or two the odometry contradicts it.

use std::collections::VecDeque;

use super::inconsistency::Inconsistency;
use super::prediction::Prediction;
use super::source_noise::normalized_innovation;
use super::sources::MotionSources;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Time between kept poses, s.
const SPACING: f64 = 0.5;
/// Time over which matches are compared with odometry, s. Up to 2 s, matches that follow people are off by more than their covariance
/// says; from 3 to 6 s makes no difference.
const DURATION: f64 = 4.0;

/// Poses of the base on the map over the last [`DURATION`], oldest first.
#[derive(Clone, Debug, Default)]
pub(super) struct RecentPath {
    poses: VecDeque<(Stamp, Pose2)>,
}

impl RecentPath {
    pub(super) fn clear(&mut self) {
        self.poses.clear();
    }

    /// Adds the pose of the latest scan. Poses that are not from just before are dropped, as after a clock step.
    pub(super) fn push(&mut self, stamp: Stamp, map_from_base: Pose2) {
        let is_just_before = |earlier: Stamp| earlier < stamp && stamp.seconds_since(earlier) <= DURATION;
        self.poses.retain(|(earlier, _)| is_just_before(*earlier));
        if self.poses.back().is_none_or(|(latest, _)| stamp.seconds_since(*latest) >= SPACING) {
            self.poses.push_back((stamp, map_from_base));
        }
    }

    /// Moves the poses with the map, as after a loop closure.
    pub(super) fn correct(&mut self, correction: &Pose2) {
        for (_, pose) in &mut self.poses {
            *pose = *correction * *pose;
        }
    }

    /// Adds to `inconsistency` that of the pose at `stamp` with the odometry since the kept pose it contradicts most.
    pub(super) fn check(
        &self,
        inconsistency: Inconsistency,
        sources: &MotionSources,
        stamp: Stamp,
        map_from_base: &Pose2,
    ) -> Inconsistency {
        let compare = |&(since, start): &(Stamp, Pose2)| {
            let motion = sources.motion_without_imu(since, stamp)?;
            let predicted = Prediction::by_wheels(motion, stamp.seconds_since(since));
            let measured = start.between(map_from_base);
            Some((normalized_innovation(&predicted, &measured), predicted, measured, start.theta))
        };
        match self.poses.iter().filter_map(compare).max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, predicted, measured, heading)) => inconsistency.and_against(&predicted, &measured, heading),
            None => Inconsistency { is_contradiction: false, ..inconsistency },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PoseCovariance;
    use crate::odometry::wheel::WheelSample;

    /// The inconsistency of a robot that drives at 1 m/s by odometry, and at `matched` m/s by matches, after `seconds`.
    fn checked(matched: f64, seconds: u32) -> Inconsistency {
        let (mut sources, mut path) = (MotionSources::default(), RecentPath::default());
        let consistent = Inconsistency { scale: 1.0, covariance: PoseCovariance::zeros(), is_contradiction: false };
        let mut found = consistent;
        for i in 0..=10 * seconds {
            let time = 0.1 * f64::from(i);
            let stamp = Stamp::from_seconds(time);
            sources.push(WheelSample { stamp, pose: Pose2::new(time, 0.0, 0.0), twist: None });
            let pose = Pose2::new(matched * time, 0.0, 0.0);
            found = path.check(consistent, &sources, stamp, &pose);
            path.push(stamp, pose);
        }
        assert!(path.poses.len() <= 9, "{}", path.poses.len());
        found
    }

    #[test]
    fn small_steps_in_the_wrong_direction_add_up() {
        let deviation = |found: &Inconsistency| found.covariance.m11.sqrt();
        assert!(deviation(&checked(1.05, 10)) < 1e-9, "within the error of the wheels");
        let found = checked(0.25, 10);
        assert!(
            found.is_contradiction && (2.8..3.05).contains(&deviation(&found)),
            "three quarters of the last 4 m: {}",
            deviation(&found)
        );
    }

    #[test]
    fn a_loop_closure_is_no_motion_and_the_past_ends_at_a_clock_step() {
        let mut path = RecentPath::default();
        let at = Stamp::from_seconds;
        path.push(at(1.0), Pose2::new(1.0, 0.0, 0.0));
        path.correct(&Pose2::new(0.0, 2.0, 0.0));
        assert_eq!(path.poses[0].1, Pose2::new(1.0, 2.0, 0.0));
        path.push(at(0.5), Pose2::IDENTITY);
        assert_eq!(path.poses, [(at(0.5), Pose2::IDENTITY)]);
        path.push(at(60.0), Pose2::IDENTITY);
        assert_eq!(path.poses.len(), 1);
        let nothing = Inconsistency { scale: 1.0, covariance: PoseCovariance::zeros(), is_contradiction: true };
        let found = path.check(nothing, &MotionSources::default(), at(61.0), &Pose2::IDENTITY);
        assert!(!found.is_contradiction, "without odometry there is nothing to contradict");
    }
}
