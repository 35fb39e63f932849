//! Registrations of scans without a match.

use super::LaserOdometry;
use super::match_problem::MatchProblem;
use super::motion_state::MotionState;
use super::pose_estimate::PoseEstimate;
use super::prediction::Prediction;
use super::previous_estimate::PreviousEstimate;
use super::registration::{Failure, FailureReason, RefinementReport, Registration};
use super::uncertainty;
use crate::anytime::ErrorEstimate;
use crate::geometry::{Pose2, PoseCovariance};
use crate::scan::Scan;
use crate::time::{Stamp, Step};

impl LaserOdometry {
    /// Registers a scan that is not newer than the previous one; `None` if it is to be matched.
    pub(super) fn check_stamp(&mut self, stamp: Stamp) -> Option<Registration> {
        let previous = self.previous?;
        let failure = match self.stamps.step(stamp, previous.stamp, self.sources.last_wheel_stamp()) {
            Step::Forward => return None,
            Step::NewRun => {
                self.counters.time_jumps += 1;
                self.restart_at(self.knobs.initial_pose);
                return None;
            }
            Step::SetBack { last: stamp } => {
                self.counters.clock_steps += 1;
                self.previous = Some(PreviousEstimate { stamp, ..previous });
                return None;
            }
            Step::Same => {
                self.counters.duplicate_scans += 1;
                Failure::new(FailureReason::DuplicateStamp, "it has the stamp of the previous scan: the answer is repeated")
            }
            Step::Late => {
                self.counters.out_of_order_scans += 1;
                let seconds = previous.stamp.seconds_since(stamp);
                Failure::new(
                    FailureReason::OutOfOrder,
                    format!("its stamp is {seconds:.3} s older than that of the previous scan: out of order"),
                )
            }
        };
        self.counters.predicted += 1;
        Some(self.repeated(&previous, failure))
    }

    /// The pose of the previous estimate again, for a scan that is not newer.
    fn repeated(&self, previous: &PreviousEstimate, failure: Failure) -> Registration {
        let (pose, covariance) = (previous.map_from_base, previous.total_covariance());
        let estimate = PoseEstimate::unmatched(failure, pose, covariance, ErrorEstimate::UNKNOWN);
        Registration { twist: previous.motion.twist, ..self.registration(estimate) }
    }

    /// Registers the first scan, which becomes the reference.
    pub(super) fn register_first(
        &mut self,
        scan: &Scan,
        base_from_laser: &Pose2,
        map_from_base: Pose2,
        covariance: PoseCovariance,
    ) -> Registration {
        self.commit(scan, base_from_laser, PoseEstimate::first(map_from_base, covariance), true)
    }

    /// Registers a scan with the predicted pose if no keyframe overlaps with it; it becomes a keyframe.
    pub(super) fn register_without_overlap(&mut self, scan: &Scan, problem: &MatchProblem) -> Registration {
        self.counters.predicted += 1;
        let failure = Failure::new(
            FailureReason::TooFewCorrespondences,
            "no earlier scan overlaps with its field of view: there is nothing to match it to",
        );
        self.commit(scan, &problem.base_from_laser, PoseEstimate::predicted(problem, failure), true)
    }

    /// Registers a scan whose match failed with the predicted pose. It becomes the keyframe, so that an unusable one is not kept
    /// forever, unless there was no time to match it.
    pub(super) fn register_failed_match(
        &mut self,
        scan: &Scan,
        problem: &MatchProblem,
        refinement: RefinementReport,
        failure: Failure,
        becomes_keyframe: bool,
        is_same_laser: bool,
    ) -> Registration {
        self.counters.predicted += 1;
        // If there was no time to match, or the scan is of another laser, the keyframe may still be good.
        let no_time = refinement.iterations == 0 && !refinement.stop_reason.is_failure();
        let is_lost = !no_time && is_same_laser;
        let predicted = PoseEstimate::predicted(problem, failure);
        let estimate = PoseEstimate { is_lost, refinement: Some(refinement), ..predicted };
        if is_lost
            && problem.awaits_odometry
            && let Some(previous) = &mut self.previous
            && !std::mem::replace(&mut previous.has_skipped_scan, true)
        {
            // The odometry to come will predict the motion better: the next scan starts from the same estimate as this one.
            let seconds = scan.stamp().seconds_since(problem.previous.stamp);
            let twist = problem.previous.motion.predict(seconds).state.twist;
            return Registration { twist, ..self.registration(estimate) };
        }
        self.commit(scan, &problem.base_from_laser, estimate, becomes_keyframe || !no_time)
    }

    /// Registers a scan with stamp `stamp` that could not be used at all.
    pub fn register_unusable(&mut self, stamp: Stamp, failure: Failure) -> Registration {
        self.start_scan();
        self.counters.predicted += 1;
        // The stamp of such a scan may be wrong too, so it does not start a new run.
        if let Some(previous) = self.previous.filter(|previous| stamp <= previous.stamp) {
            return self.repeated(&previous, failure);
        }
        let (start, start_covariance, prediction) = match self.previous {
            Some(previous) => {
                let problem = self.match_problem(&previous, stamp, &Pose2::IDENTITY);
                (previous.map_from_base, previous.total_covariance(), problem.prediction)
            }
            None => (self.start_pose, PoseCovariance::zeros(), Prediction::NO_MOTION),
        };
        let map_from_base = start * prediction.motion;
        let covariance = uncertainty::compound(&start, &start_covariance, &prediction.motion, &prediction.covariance);
        let state = self.previous.map_or_else(
            || MotionState::unknown(&covariance),
            |previous| previous.motion.predict(stamp.seconds_since(previous.stamp)).state,
        );
        // The next prediction starts from the previous scan, or from here if there is none.
        if self.keyframe.is_none() && self.pending_keyframe.is_none() {
            self.previous = Some(PreviousEstimate::new(stamp, map_from_base, covariance, &state));
        }
        let error = ErrorEstimate::of_covariance(&prediction.covariance);
        let estimate = PoseEstimate::unmatched(failure, map_from_base, covariance, error);
        Registration { twist: state.twist, ..self.registration(estimate) }
    }
}
