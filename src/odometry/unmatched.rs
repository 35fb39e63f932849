//! Registrations of scans without a match.

use super::match_problem::{MatchProblem, PreviousEstimate};
use super::motion_state::MotionState;
use super::pose_estimate::PoseEstimate;
use super::prediction::Prediction;
use super::registration::{Failure, FailureReason, Outcome, RefinementReport, Registration};
use super::scale_error::ScaleJacobian;
use super::{LaserOdometry, uncertainty};
use crate::anytime::ErrorEstimate;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
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
        let registration = self.registration(Outcome::Predicted(failure), previous.map_from_base, &previous.total_covariance());
        Some(Registration { twist: previous.motion.twist, ..registration })
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

    /// Registers a scan with the predicted pose. `is_lost`: the scan could not be matched, and becomes the keyframe, so that an
    /// unusable keyframe is not kept forever.
    pub(super) fn register_prediction(
        &mut self,
        scan: &Scan,
        problem: &MatchProblem,
        refinement: Option<RefinementReport>,
        failure: Failure,
        becomes_keyframe: bool,
        is_lost: bool,
    ) -> Registration {
        self.counters.predicted += 1;
        if is_lost
            && problem.awaits_odometry
            && let Some(previous) = &mut self.previous
            && !std::mem::replace(&mut previous.has_skipped_scan, true)
        {
            // The odometry to come will predict the motion better: the next scan starts from the same estimate as this one.
            let twist =
                problem.previous.motion.predict(scan.stamp().seconds_since(problem.previous.stamp)).without_measurement().twist;
            let error = ErrorEstimate::of_covariance(&problem.prediction.covariance);
            let (map_from_base, covariance) = problem.predicted_base();
            return Registration {
                refinement,
                ..self.register_without_update(failure, map_from_base, &covariance, (twist, error))
            };
        }
        let estimate = PoseEstimate { is_lost, refinement, ..PoseEstimate::predicted(problem, failure) };
        self.commit(scan, &problem.base_from_laser, estimate, becomes_keyframe)
    }

    /// Registers a scan with stamp `stamp` that could not be used at all.
    pub fn register_unusable(&mut self, stamp: Stamp, failure: Failure) -> Registration {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
        self.counters.predicted += 1;
        // The stamp of such a scan may be wrong too, so it does not start a new run.
        if let Some(previous) = self.previous.filter(|previous| stamp <= previous.stamp) {
            return self.register_without_update(
                failure,
                previous.map_from_base,
                &previous.total_covariance(),
                (previous.motion.twist, ErrorEstimate::UNKNOWN),
            );
        }
        let (map_from_base, covariance, prediction) = match self.previous {
            Some(previous) => (
                previous.map_from_base,
                previous.total_covariance(),
                self.match_problem(&previous, stamp, &Pose2::IDENTITY).prediction,
            ),
            None => (self.start_pose, PoseCovariance::zeros(), Prediction::NO_MOTION),
        };
        let Prediction { motion, covariance: motion_covariance } = prediction;
        let covariance = uncertainty::compound(&map_from_base, &covariance, &motion, &motion_covariance);
        let map_from_base = map_from_base * motion;
        let error = ErrorEstimate::of_covariance(&motion_covariance);
        let state = self.previous.map_or_else(
            || MotionState::unknown(&covariance),
            |previous| previous.motion.predict(stamp.seconds_since(previous.stamp)).without_measurement(),
        );
        let twist = state.twist;
        // The next prediction starts from the previous scan, or from here if there is none.
        if self.keyframe.is_none() && self.pending_keyframe.is_none() {
            self.previous = Some(PreviousEstimate {
                stamp,
                map_from_base,
                map_from_laser: map_from_base,
                covariance,
                by_scale: ScaleJacobian::NONE,
                covariance_to_keyframe: PoseCovariance::zeros(),
                measured_twist: twist,
                mean_twist: twist,
                motion: state,
                has_skipped_scan: false,
            });
        }
        self.register_without_update(failure, map_from_base, &covariance, (twist, error))
    }

    /// A registration with the prediction, which leaves the state unchanged.
    pub(super) fn register_without_update(
        &self,
        failure: Failure,
        map_from_base: Pose2,
        covariance: &PoseCovariance,
        (twist, error): (Twist2, ErrorEstimate),
    ) -> Registration {
        let registration = self.registration(Outcome::Predicted(failure), map_from_base, covariance);
        Registration { twist, predicted_error: error, estimated_error: error, ..registration }
    }
}
