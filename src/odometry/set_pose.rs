//! A pose set by the user, as in `RViz`: the odometry continues from there.
//!
//! In a simulator the same message moves the robot, and it is unknown which scan is the first one of the new place: the scan
//! taken for it may still show the old place. So the new reference is on probation. A scan that no robot motion can connect to it
//! was taken at the new place; it replaces the reference, at the pose that was set.

use super::match_problem::MatchProblem;
use super::match_scan::MatchResult;
use super::motion_state::MotionState;
use super::prediction::Prediction;
use super::previous_estimate::PreviousEstimate;
use super::registration::Registration;
use super::{LaserOdometry, uncertainty};
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::scan::Scan;
use crate::time::Stamp;

/// How long after the pose the reference may still be replaced, s: subscribers receive a set pose within about 0.1 s of each
/// other.
const PROBATION: f64 = 1.0;
/// Maximum time over which the robot is assumed to have kept its velocity, s.
const MAX_GAP: f64 = 1.0;
/// A scan whose agreement is this far below the typical one shows another place.
const MIN_AGREEMENT_DROP: f64 = 0.15;

/// The pose that was set.
#[derive(Clone, Copy, Debug)]
pub(super) struct SetPose {
    map_from_base: Pose2,
    /// When the robot was there.
    stamp: Stamp,
    /// Typical fraction of rays that agree with the reference.
    typical_agreement: f64,
    /// The agreement of the previous scan was too low.
    disagreed: bool,
}

impl SetPose {
    fn is_on_probation(&self, stamp: Stamp) -> bool {
        (0.0..=PROBATION).contains(&stamp.seconds_since(self.stamp))
    }

    /// Whether the agreement is unusually low. If it is so twice in a row, although the reference was replaced after the first
    /// time, a low agreement is typical of this place.
    fn is_agreement_unusual(&mut self, agreement: Option<f64>) -> bool {
        let Some(agreement) = agreement else { return false };
        let disagrees = agreement < self.typical_agreement - MIN_AGREEMENT_DROP;
        if disagrees && self.disagreed {
            self.typical_agreement = agreement;
        }
        self.disagreed = disagrees && !self.disagreed;
        self.disagreed
    }
}

impl LaserOdometry {
    /// Continues from a pose that the robot had at `stamp`: the next scan becomes the first one, at that pose moved on by the
    /// robot's motion since then. Map and odom coincide again.
    pub fn set_pose(&mut self, map_from_base: Pose2, stamp: Stamp) {
        let typical_agreement = self.typical_agreement;
        self.restart_at(map_from_base);
        self.set_pose = Some(SetPose { map_from_base, stamp, typical_agreement, disagreed: false });
    }

    /// The registration of the first scan after a pose was set; `None` if this is another scan.
    pub(super) fn register_at_set_pose(&mut self, scan: &Scan, base_from_laser: &Pose2) -> Option<Registration> {
        let set = self.set_pose.filter(|_| self.previous.is_none())?;
        // After a long gap the motion since then is unknown.
        let seconds = scan.stamp().seconds_since(set.stamp);
        let since = if (0.0..=MAX_GAP).contains(&seconds) { set.stamp } else { scan.stamp() };
        Some(self.begin_from(&set, scan, base_from_laser, since))
    }

    /// Replaces the reference by this scan if its match shows that the reference was not taken at the pose that was set.
    pub(super) fn replace_refuted_reference(
        &mut self,
        scan: &Scan,
        problem: &MatchProblem,
        result: &MatchResult,
    ) -> Option<Registration> {
        let set = self.set_pose.as_mut().filter(|set| set.is_on_probation(scan.stamp()))?;
        let previous = &problem.previous;
        let seconds = scan.stamp().seconds_since(previous.stamp);
        let measured = result.estimate.as_ref().map_or(previous.measured_twist, |estimate| {
            Twist2::from_motion(&previous.map_from_base.between(&estimate.map_from_base), seconds)
        });
        let is_unusual = set.is_agreement_unusual(result.agreement);
        if !is_unusual && result.estimate.is_ok() && previous.can_reach(&measured, seconds) {
            return None;
        }
        let set = *set;
        self.forget_reference();
        // The robot was moved here after the previous scan.
        let registration = self.begin_from(&set, scan, &problem.base_from_laser, previous.stamp);
        if let Some(previous) = &mut self.previous {
            previous.measured_twist = measured; // if the motion continues like this, the assumed velocity was wrong
        }
        Some(registration)
    }

    /// Registers a scan as the first one. The robot was at the pose that was set at time `since`, and keeps its velocity.
    fn begin_from(&mut self, set: &SetPose, scan: &Scan, base_from_laser: &Pose2, since: Stamp) -> Registration {
        let (seconds, none) = (scan.stamp().seconds_since(since), PoseCovariance::zeros());
        if seconds <= 0.0 {
            self.previous = None;
            return self.register_first(scan, base_from_laser, set.map_from_base, none);
        }
        let state = MotionState::assumed(self.typical_twist);
        let Prediction { motion, covariance } = state.predict(seconds).prediction();
        self.previous = Some(PreviousEstimate::new(since, set.map_from_base, none, &state));
        let covariance = uncertainty::compound(&set.map_from_base, &none, &motion, &covariance);
        self.register_first(scan, base_from_laser, set.map_from_base * motion, covariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_scan_that_disagrees_shows_another_place_but_two_are_typical_here() {
        let pose = Pose2::IDENTITY;
        let mut set = SetPose { map_from_base: pose, stamp: Stamp::default(), typical_agreement: 0.95, disagreed: false };
        let mut answers = |agreements: &[f64]| {
            agreements.iter().map(|agreement| set.is_agreement_unusual(Some(*agreement))).collect::<Vec<_>>()
        };
        assert_eq!(answers(&[0.9, 0.5, 0.94, 0.6]), [false, true, false, true]);
        assert_eq!(answers(&[0.6, 0.62, 0.3]), [false, false, true]);
        assert!(!set.is_agreement_unusual(None));
    }
}
