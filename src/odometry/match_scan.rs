//! Matches a scan to the keyframe.

use super::inconsistency::Inconsistency;
use super::keyframe_pose::KeyframePose;
use super::match_problem::MatchProblem;
use super::pose_estimate::PoseEstimate;
use super::registration::{self, Failure, FailureReason, RefinementReport};
use super::{LaserOdometry, OdometryKnobs, TYPICAL_WEIGHT, uncertainty};
use crate::anytime::{ContractRunner, estimated_error};
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{FirstGuess, StopReason};
use crate::scan::Scan;
use crate::time::Stamp;

/// The result of matching one scan.
pub(super) struct MatchResult {
    pub(super) report: RefinementReport,
    pub(super) keyframe_from_laser: Pose2,
    /// Fraction of the rays that agree with the reference, if it is known.
    pub(super) agreement: Option<f64>,
    /// The estimate, or why the match failed.
    pub(super) estimate: Result<PoseEstimate, Failure>,
}

impl LaserOdometry {
    /// Matches a scan to the keyframe, starting from the pose `start`.
    pub(super) fn match_scan(
        &mut self,
        keyframe: &KeyframePose,
        scan: &Scan,
        problem: &MatchProblem,
        start: Pose2,
        runner: &mut ContractRunner,
    ) -> MatchResult {
        let prior = Some(problem.prior(keyframe, &PoseCovariance::zeros()));
        let guess = FirstGuess { pose: start, prior, window: problem.window(self.typical_agreement) };
        let mut refinement = self.matcher.begin(scan, guess);
        let stop_reason = runner.run(&mut refinement);
        self.iterations.clear();
        self.iterations.extend_from_slice(refinement.trace());
        let uncertainty = refinement.uncertainty();
        let agreement = refinement.agreement();
        if let Some(agreement) = agreement {
            self.typical_agreement += TYPICAL_WEIGHT * (agreement - self.typical_agreement);
        }
        let keyframe_from_laser = refinement.pose();
        let base_heading = keyframe_from_laser.theta - problem.base_from_laser.theta;
        let report = registration::report(&refinement, stop_reason, uncertainty.as_ref(), base_heading);
        let match_covariance = uncertainty.and_then(|known| known.covariance);
        let estimated_error = estimated_error(&refinement, match_covariance.as_ref());
        if self.keep_matched_points {
            self.matched_points = Some(registration::matched_points(&refinement, &self.views, &keyframe.map_from_laser));
        }
        let map_from_laser = keyframe.map_from_laser * keyframe_from_laser;
        let correction = problem.predicted_laser().between(&map_from_laser);
        let estimate = check_match(&report, &correction, &self.knobs).map(|()| {
            let correlated = uncertainty::correlated_rays(scan, report.last.rays);
            let inconsistency = self.inconsistency(problem, &map_from_laser, scan.stamp());
            let by_match = uncertainty.as_ref();
            let estimate = PoseEstimate::matched(problem, keyframe, &keyframe_from_laser, by_match, correlated, &inconsistency);
            PoseEstimate { estimated_error, refinement: Some(report), ..estimate }
        });
        MatchResult { report, keyframe_from_laser, agreement, estimate }
    }

    /// How far a match that puts the laser at `map_from_laser` is inconsistent with odometry and with how a robot can move.
    fn inconsistency(&self, problem: &MatchProblem, map_from_laser: &Pose2, stamp: Stamp) -> Inconsistency {
        let map_from_base = *map_from_laser * problem.base_from_laser.inverse();
        let previous = &problem.previous.map_from_base;
        let step = previous.between(&map_from_base);
        let inconsistency = Inconsistency::of_step(self.noise.odometry, problem.odometry.as_ref(), &step).and_against(
            &problem.constant_velocity,
            &step,
            previous.theta,
        );
        self.recent_path.check(inconsistency, &self.sources, stamp, &map_from_base)
    }
}

/// Whether to use the match, or why to reject it.
fn check_match(report: &RefinementReport, correction: &Pose2, knobs: &OdometryKnobs) -> Result<(), Failure> {
    let (distance, angle) = (correction.distance(), correction.theta.abs());
    Err(match report.stop_reason {
        StopReason::Singular => Failure::new(FailureReason::Singular, "the correspondences do not determine a pose"),
        StopReason::TooFewCorrespondences => Failure::new(
            FailureReason::TooFewCorrespondences,
            format!("too few correspondences: the scan of {} rays does not fit the reference", report.rays),
        ),
        StopReason::Interrupted if report.iterations == 0 => {
            Failure::new(FailureReason::Interrupted, "the answer was requested before the first iteration")
        }
        _ if report.iterations == 0 => Failure::new(FailureReason::NoTime, "the time budget leaves no time for an iteration"),
        _ if distance > knobs.max_correction_distance || angle > knobs.max_correction_angle => Failure::new(
            FailureReason::CorrectionTooLarge,
            format!(
                "the match corrects the prediction by {distance:.2} m and {:.1} degrees: more than max_correction_distance or \
                 max_correction_angle",
                angle.to_degrees()
            ),
        ),
        _ => return Ok(()),
    })
}
