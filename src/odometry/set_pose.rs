//! A pose that somebody has set, as in `RViz`: the odometry goes on from there.
//!
//! In a simulator the same message moves the robot, and nobody tells which scan is the first one of the new place: the one that is
//! taken for it may still be of the old place. So its place as the reference is on probation. A scan that does not go on from it by any
//! motion of a robot was taken at the new place: it becomes the reference instead, at the pose that was set.

use super::attempt::{Attempt, Last};
use super::motion_state::MotionState;
use super::prediction::Prediction;
use super::registration::Registration;
use super::{Found, LaserOdometry, is_steady, uncertainty};
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::scan::Scan;
use crate::time::Stamp;

/// For so long after the pose its reference may turn out to be of another place, s: subscribers hear of a pose some 0.1 s apart.
const PROBATION: f64 = 1.0;
/// A robot is taken to have gone on as before for so long, s.
const LONGEST_GAP: f64 = 1.0;
/// The part of the rays that agree is below what is usual by this much: the scan is of another place.
const DISAGREEING: f64 = 0.15;

/// The pose that was set.
#[derive(Clone, Copy, Debug)]
pub(super) struct SetPose {
    map_from_base: Pose2,
    /// When the robot was there.
    held_at: Stamp,
    /// The part of the rays that usually agree with the reference.
    usual_agreement: f64,
    /// The last scan agreed less.
    disagreed: bool,
}

impl SetPose {
    fn is_on_probation(&self, stamp: Stamp) -> bool {
        (0.0..=PROBATION).contains(&stamp.seconds_since(self.held_at))
    }

    /// Whether fewer rays agree than usual. Where that is so twice in a row, though the first time the reference was replaced, so few
    /// agree in this place.
    fn is_unlike_usual(&mut self, agreement: Option<f64>) -> bool {
        let Some(agreement) = agreement else { return false };
        let disagrees = agreement < self.usual_agreement - DISAGREEING;
        if disagrees && self.disagreed {
            self.usual_agreement = agreement;
        }
        self.disagreed = disagrees && !self.disagreed;
        self.disagreed
    }
}

impl LaserOdometry {
    /// Goes on from a pose that the robot had when `held_at`: the next scan is the first one, and takes the robot's motion since then
    /// into account. Map and odom are one again.
    pub fn set_pose(&mut self, map_from_base: Pose2, held_at: Stamp) {
        let usual_agreement = self.usual_agreement;
        self.restart_at(map_from_base);
        self.set_pose = Some(SetPose { map_from_base, held_at, usual_agreement, disagreed: false });
    }

    /// The answer for the first scan after a pose was set, if this is one.
    pub(super) fn answer_at_set_pose(&mut self, scan: &Scan, base_from_laser: &Pose2) -> Option<Registration> {
        let set = self.set_pose.filter(|_| self.last.is_none())?;
        // After a long silence nothing is known of the motion since.
        let seconds = scan.stamp().seconds_since(set.held_at);
        let since = if (0.0..=LONGEST_GAP).contains(&seconds) { set.held_at } else { scan.stamp() };
        Some(self.begin_from(&set, scan, base_from_laser, since))
    }

    /// Whether a match shows that the reference is not of the place that was set.
    pub(super) fn is_reference_refuted(&mut self, attempt: &Attempt, found: &Found, stamp: Stamp) -> bool {
        let Some(set) = self.set_pose.as_mut().filter(|set| set.is_on_probation(stamp)) else { return false };
        let (seen, seconds) = seen_twist_of(attempt, found, stamp);
        let jumps = [attempt.last.motion.twist, attempt.last.seen_twist].iter().all(|twist| !is_steady(twist, &seen, seconds));
        set.is_unlike_usual(found.agreement) || found.answer.is_err() || jumps
    }

    /// The scan that refutes the reference takes its place.
    pub(super) fn replace_reference(&mut self, scan: &Scan, attempt: &Attempt, found: &Found) -> Option<Registration> {
        let set = self.set_pose?;
        let (seen, _) = seen_twist_of(attempt, found, scan.stamp());
        self.forget_reference();
        // The robot has come here since the last scan.
        let answer = self.begin_from(&set, scan, &attempt.base_from_laser, attempt.last.stamp);
        if let Some(last) = &mut self.last {
            last.seen_twist = seen; // where it goes on like that, the robot's motion was not known before
        }
        Some(answer)
    }

    /// The answer for a scan that is the first one; the robot was at the pose that was set when it was `since`, and moves as it did.
    fn begin_from(&mut self, set: &SetPose, scan: &Scan, base_from_laser: &Pose2, since: Stamp) -> Registration {
        let (seconds, twist, none) = (scan.stamp().seconds_since(since), self.usual_twist, PoseCovariance::zeros());
        if seconds <= 0.0 {
            self.last = None;
            return self.answer_first(scan, base_from_laser, set.map_from_base, none);
        }
        let goes_on = MotionState::supposed(twist);
        let Prediction { motion, covariance } = goes_on.expect(seconds).prediction();
        let (map_from_base, map_from_laser) = (set.map_from_base, set.map_from_base * *base_from_laser);
        self.last = Some(Last {
            stamp: since,
            map_from_base,
            map_from_laser,
            covariance: none,
            covariance_to_keyframe: none,
            seen_twist: twist,
            mean_twist: twist,
            motion: goes_on,
            passed_over: false,
        });
        let covariance = uncertainty::compound(&set.map_from_base, &none, &motion, &covariance);
        self.answer_first(scan, base_from_laser, set.map_from_base * motion, covariance)
    }
}

/// The velocity that leads from the last answer to what a match has come to, and the time that took, s.
fn seen_twist_of(attempt: &Attempt, found: &Found, stamp: Stamp) -> (Twist2, f64) {
    let seconds = stamp.seconds_since(attempt.last.stamp);
    let motion = found.answer.as_ref().map(|answer| attempt.last.map_from_base.between(&answer.map_from_base));
    (motion.map_or(attempt.last.seen_twist, |motion| Twist2::of_motion(&motion, seconds)), seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_scan_that_disagrees_is_of_another_place_and_two_are_usual_here() {
        let pose = Pose2::IDENTITY;
        let mut set = SetPose { map_from_base: pose, held_at: Stamp::default(), usual_agreement: 0.95, disagreed: false };
        let mut answers =
            |agreements: &[f64]| agreements.iter().map(|share| set.is_unlike_usual(Some(*share))).collect::<Vec<_>>();
        assert_eq!(answers(&[0.9, 0.5, 0.94, 0.6]), [false, true, false, true]);
        assert_eq!(answers(&[0.6, 0.62, 0.3]), [false, false, true]);
        assert!(!set.is_unlike_usual(None));
    }
}
