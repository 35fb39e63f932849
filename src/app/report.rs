//! The report on an answer: the one record that the message, the CSV row and the summary are made from.

use super::Estimate;
use super::localizer::Fix;
use crate::anytime::ErrorEstimate;
use crate::io::profile_file::ExpectedError;
use crate::localization::estimate::Belief;
use crate::messages::own::{Contract, FilterReport, MatchReport};
use crate::messages::std_msgs::Header;
use crate::odometry::{Failure, OdometryCounters, Outcome};

impl Estimate {
    /// The report. Values are NaN if there was no refinement. `dropped`: number of scans dropped so far.
    pub fn report(&self, header: Header, counters: &OdometryCounters, dropped: u64) -> MatchReport {
        let answer = &self.registration;
        let refinement = answer.refinement.as_ref();
        let number = |value: fn(&_) -> f64| refinement.map_or(f64::NAN, value);
        let whole = |value: fn(&_) -> u32| refinement.map_or(0, value);
        let expected = |value: fn(&ExpectedError) -> f64| self.expected_error.as_ref().map_or(f64::NAN, value);
        let (outcome, failure) = match &answer.outcome {
            Outcome::Matched => (MatchReport::MATCHED, None),
            Outcome::First => (MatchReport::FIRST, None),
            Outcome::Predicted(failure) => (MatchReport::PREDICTED, Some(failure)),
        };
        let Contract { time_budget, translation_error_bound, rotation_error_bound, .. } = (&self.contract).into();
        MatchReport {
            header,
            outcome,
            ok: answer.outcome.is_ok(),
            stop_reason: refinement.map_or("", |r| r.stop_reason.name()).into(),
            failure: failure.map_or("", |failure| failure.reason.name()).into(),
            reason: failure.map_or_else(String::new, Failure::to_string),
            time_budget,
            translation_error_bound,
            rotation_error_bound,
            elapsed: self.elapsed.into(),
            deadline_met: self.deadline_met(),
            overrun: self.overrun().into(),
            translation_error_excess: self.error_excess().translation,
            rotation_error_excess: self.error_excess().rotation,
            expected_translation_error: expected(|e| e.position_mean_m),
            expected_translation_error_p95: expected(|e| e.position_p95_m),
            expected_rotation_error: expected(|e| e.orientation_mean_rad),
            expected_rotation_error_p95: expected(|e| e.orientation_p95_rad),
            outside_profile: self.outside_profile.map_or_else(String::new, |outside| outside.to_string()),
            iterations: whole(|r| r.iterations),
            rays: whole(|r| r.rays),
            rays_used: whole(|r| r.last.rays),
            correspondences: whole(|r| r.last.correspondences),
            inliers: whole(|r| r.last.inliers),
            mean_residual: number(|r| r.last.mean_residual),
            inlier_ratio: f64::from(whole(|r| r.last.inliers)) / f64::from(whole(|r| r.last.rays).max(1)),
            predicted_translation_error: answer.predicted_error.translation,
            predicted_rotation_error: answer.predicted_error.rotation,
            translation_error: answer.estimated_error.translation,
            rotation_error: answer.estimated_error.rotation,
            condition_number: number(|r| r.condition_number),
            free_direction: number(|r| r.free_direction.unwrap_or(f64::NAN)),
            disbelieved: answer.rejected_sources.names().collect::<Vec<_>>().join(" "),
            new_keyframe: answer.new_keyframe,
            keyframes: count(counters.keyframes),
            closed_loops: count(counters.closed_loops),
            dropped: count(dropped),
        }
    }
}

impl Fix {
    /// The report. Values are NaN if the filter did not use the scan. `dropped`: number of scans dropped so far.
    pub fn report(&self, header: Header, dropped: u64) -> FilterReport {
        let belief = self.belief.as_ref();
        let number = |value: fn(&_) -> f64| belief.map_or(f64::NAN, value);
        let whole = |value: fn(&_) -> usize| count(belief.map_or(0, value) as u64);
        let Contract { time_budget, translation_error_bound, rotation_error_bound, .. } = (&self.contract).into();
        FilterReport {
            header,
            ok: belief.is_ok(),
            failure: belief.err().map_or("", |problem| problem.code()).into(),
            reason: belief.err().map_or_else(String::new, ToString::to_string),
            stop_reason: self.stop_reason.map_or("", |reason| reason.name()).into(),
            time_budget,
            translation_error_bound,
            rotation_error_bound,
            elapsed: self.elapsed.into(),
            deadline_met: self.overrun().is_zero(),
            overrun: self.overrun().into(),
            localized: belief.is_ok_and(Belief::is_localized),
            particles: whole(|belief| belief.particles),
            effective: number(|belief| belief.effective),
            beams: whole(|belief| belief.beams),
            fit: number(|belief| belief.fit),
            explained: number(|belief| belief.explained),
            share: number(|belief| belief.share),
            translation_error: number(|belief| ErrorEstimate::of_covariance(&belief.covariance).translation),
            rotation_error: number(|belief| ErrorEstimate::of_covariance(&belief.covariance).rotation),
            dropped: count(dropped),
        }
    }
}

/// Converts a count to the 32 bits of the message.
fn count(number: u64) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
