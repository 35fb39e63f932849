//! Distinguishes a clock that was set forward from a gap in the data, by the scans alone.

use super::LaserOdometry;
use super::keyframe_pose::KeyframePose;
use super::match_problem::{AGREEMENT_VARIATION, MatchProblem};
use super::match_scan::MatchResult;
use super::previous_estimate::PreviousEstimate;
use crate::anytime::ContractRunner;
use crate::matching::StopReason;
use crate::scan::Scan;

/// Minimum delay after which a clock step is considered, in typical scan periods. Shorter delays are bridged by the search.
const MIN_LATE_PERIODS: f64 = 4.0;

impl LaserOdometry {
    /// Tests whether the clock was set forward before a late scan: matches it again as if only one typical period had passed.
    /// Returns that match if it fits clearly better than the one at the time of the stamp. With odometry there is no need for it.
    pub(super) fn match_after_clock_step(
        &mut self,
        keyframe: &KeyframePose,
        scan: &Scan,
        problem: &MatchProblem,
        result: &MatchResult,
        runner: &mut ContractRunner,
    ) -> Option<(MatchProblem, MatchResult)> {
        let is_done = !matches!(result.report.stop_reason, StopReason::Budget | StopReason::Interrupted)
            && result.estimate.as_ref().err().is_none_or(|failure| failure.reason.is_no_fit());
        let seconds = scan.stamp().seconds_since(problem.previous.stamp);
        let came_late = self.typical_period > 0.0 && seconds > MIN_LATE_PERIODS * self.typical_period;
        if problem.odometry.is_some() || !came_late || !is_done {
            return None;
        }
        let previous = PreviousEstimate { stamp: scan.stamp().offset_by(-self.typical_period), ..problem.previous };
        let constant_velocity = previous.motion.predict(self.typical_period).prediction();
        let problem = MatchProblem { previous, constant_velocity, prediction: constant_velocity, imu_rotation: None, ..*problem };
        let first_guess = keyframe.map_from_laser.between(&problem.predicted_laser());
        let previous_result = (std::mem::take(&mut self.iterations), self.matched_points.take());
        let refit = self.match_scan(keyframe, scan, &problem, first_guess, runner);
        let is_better =
            result.estimate.is_err() || refit.agreement > result.agreement.map(|agreement| agreement + AGREEMENT_VARIATION);
        if refit.estimate.is_err() || !is_better {
            (self.iterations, self.matched_points) = previous_result;
            return None;
        }
        self.counters.clock_steps += 1;
        self.previous = Some(previous);
        Some((problem, refit))
    }
}
