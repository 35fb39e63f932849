//! A clock that was set forward, told from a gap by the scans alone.

use super::LaserOdometry;
use super::answer::Found;
use super::attempt::{Attempt, Last, USUAL_VARIATION};
use super::placement::Placement;
use crate::anytime::Driver;
use crate::matching::StopReason;
use crate::scan::Scan;

/// So many times as long as usual after the last one, a scan has come late, or the clock was set. Less than that a search bridges.
const LATE_BY_PERIODS: f64 = 4.0;

impl LaserOdometry {
    /// A match where the robot has hardly moved, of a scan that comes later than usual, where that fits decidedly better than where the
    /// velocity leads in that time: the clock was set forward, and the robot has driven on for no longer than from any scan to the next.
    /// Odometry would know.
    pub(super) fn match_where_the_clock_was_set(
        &mut self,
        keyframe: &Placement,
        scan: &Scan,
        attempt: &Attempt,
        found: &Found,
        driver: &mut Driver,
    ) -> Option<(Attempt, Found)> {
        let is_done = !matches!(found.report.stop_reason, StopReason::Budget | StopReason::Interrupted)
            && found.answer.as_ref().err().is_none_or(|failure| failure.reason.is_no_fit());
        let seconds = scan.stamp().seconds_since(attempt.last.stamp);
        let came_late = self.usual_period > 0.0 && seconds > LATE_BY_PERIODS * self.usual_period;
        if attempt.said.is_some() || !came_late || !is_done {
            return None;
        }
        let last = Last { stamp: scan.stamp().offset_by(-self.usual_period), ..attempt.last };
        let expected = last.motion.expect(self.usual_period).prediction();
        let attempt = Attempt { last, expected, prediction: expected, said_turn: None, ..*attempt };
        let first_guess = keyframe.map_from_laser.between(&attempt.predicted_laser());
        let shown = (std::mem::take(&mut self.iterations), self.matched_points.take());
        let fits = self.match_to(keyframe, scan, &attempt, first_guess, driver);
        let is_better = found.answer.is_err() || fits.agreement > found.agreement.map(|agreement| agreement + USUAL_VARIATION);
        if fits.answer.is_err() || !is_better {
            (self.iterations, self.matched_points) = shown;
            return None;
        }
        self.counters.clock_steps += 1;
        self.last = Some(last);
        Some((attempt, fits))
    }
}
