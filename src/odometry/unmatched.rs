//! Answers for scans that were not matched.

use super::answer::Answer;
use super::attempt::{Attempt, Last};
use super::motion_state::MotionState;
use super::prediction::Prediction;
use super::registration::{Failure, FailureReason, Outcome, RefinementReport, Registration};
use super::{LaserOdometry, uncertainty};
use crate::anytime::ErrorEstimate;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::scan::Scan;
use crate::time::{Stamp, Step};

impl LaserOdometry {
    /// Scans that are not later than the last one are answered without a match.
    pub(super) fn answer_by_stamp(&mut self, stamp: Stamp) -> Option<Registration> {
        let last = self.last?;
        let problem = match self.stamps.step(stamp, last.stamp, self.sources.last_wheel_stamp()) {
            Step::Forward => return None,
            Step::NewRun => {
                self.counters.time_jumps += 1;
                self.restart_at(self.knobs.initial_pose);
                return None;
            }
            Step::SetBack { last: stamp } => {
                self.counters.clock_steps += 1;
                self.last = Some(Last { stamp, ..last });
                return None;
            }
            Step::Same => {
                self.counters.duplicate_scans += 1;
                Failure::new(FailureReason::DuplicateStamp, "its stamp is that of the scan before: the same answer again")
            }
            Step::Late => {
                self.counters.out_of_order_scans += 1;
                let seconds = last.stamp.seconds_since(stamp);
                Failure::new(
                    FailureReason::OutOfOrder,
                    format!("its stamp is {seconds:.3} s before that of the last scan: out of order"),
                )
            }
        };
        self.counters.predicted += 1;
        let answer = self.registration(Outcome::Predicted(problem), last.map_from_base, &last.covariance);
        Some(Registration { twist: last.motion.twist, ..answer })
    }

    /// The first scan that others can be matched to.
    pub(super) fn answer_first(
        &mut self,
        scan: &Scan,
        base_from_laser: &Pose2,
        map_from_base: Pose2,
        covariance: PoseCovariance,
    ) -> Registration {
        self.conclude(scan, base_from_laser, Answer::first(map_from_base, covariance), true)
    }

    /// A scan that looks where none has looked is answered by the prediction; others can be matched to it.
    pub(super) fn answer_unseen(&mut self, scan: &Scan, attempt: &Attempt) -> Registration {
        self.counters.predicted += 1;
        let problem = Failure::new(
            FailureReason::TooFewCorrespondences,
            "it looks where no scan has looked before: there is nothing to match",
        );
        self.conclude(scan, &attempt.base_from_laser, Answer::predicted(attempt, problem), true)
    }

    /// The prediction as answer. `is_lost`: the scan could not be matched. It becomes the keyframe then: the one it was to be matched to
    /// must not be kept for ever.
    pub(super) fn answer_predicted(
        &mut self,
        scan: &Scan,
        attempt: &Attempt,
        refinement: Option<RefinementReport>,
        problem: Failure,
        becomes_keyframe: bool,
        is_lost: bool,
    ) -> Registration {
        self.counters.predicted += 1;
        if is_lost
            && attempt.awaits_odometry
            && let Some(start) = &mut self.last
            && !std::mem::replace(&mut start.passed_over, true)
        {
            // What comes says better how the robot has moved: the next scan starts from where this one did.
            let twist = attempt.last.motion.expect(scan.stamp().seconds_since(attempt.last.stamp)).unseen().twist;
            let error = ErrorEstimate::of_covariance(&attempt.prediction.covariance);
            let (map_from_base, covariance) = attempt.predicted_base();
            return Registration { refinement, ..self.passing(problem, map_from_base, &covariance, (twist, error)) };
        }
        let answer = Answer { is_lost, refinement, ..Answer::predicted(attempt, problem) };
        self.conclude(scan, &attempt.base_from_laser, answer, becomes_keyframe)
    }

    /// An answer for a scan that could not be used at all, taken at `stamp`.
    pub fn answer_unusable(&mut self, stamp: Stamp, problem: Failure) -> Registration {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
        self.counters.predicted += 1;
        // The stamp of such a scan may be as wrong as the rest of it: no run starts again by it.
        if let Some(last) = self.last.filter(|last| stamp <= last.stamp) {
            return self.passing(problem, last.map_from_base, &last.covariance, (last.motion.twist, ErrorEstimate::UNKNOWN));
        }
        let (map_from_base, covariance, prediction) = match self.last {
            Some(last) => (last.map_from_base, last.covariance, self.attempt(&last, stamp, &Pose2::IDENTITY).prediction),
            None => (self.start, PoseCovariance::zeros(), Prediction::NONE),
        };
        let Prediction { motion, covariance: motion_covariance } = prediction;
        let covariance = uncertainty::compound(&map_from_base, &covariance, &motion, &motion_covariance);
        let map_from_base = map_from_base * motion;
        let error = ErrorEstimate::of_covariance(&motion_covariance);
        let state = self.last.map_or_else(
            || MotionState::unknown(&covariance),
            |last| last.motion.expect(stamp.seconds_since(last.stamp)).unseen(),
        );
        let twist = state.twist;
        // The next scan's prediction starts from the last scan there was; where there was none, from here.
        if self.keyframe.is_none() && self.upcoming_keyframe.is_none() {
            self.last = Some(Last {
                stamp,
                map_from_base,
                map_from_laser: map_from_base,
                covariance,
                covariance_to_keyframe: PoseCovariance::zeros(),
                seen_twist: twist,
                mean_twist: twist,
                motion: state,
                passed_over: false,
            });
        }
        self.passing(problem, map_from_base, &covariance, (twist, error))
    }

    /// A prediction that the next scan does not start from.
    pub(super) fn passing(
        &self,
        problem: Failure,
        map_from_base: Pose2,
        covariance: &PoseCovariance,
        (twist, error): (Twist2, ErrorEstimate),
    ) -> Registration {
        let answer = self.registration(Outcome::Predicted(problem), map_from_base, covariance);
        Registration { twist, predicted_error: error, estimated_error: error, ..answer }
    }
}
