//! What comes of a scan, before it is taken in: a pose, what is known of it, and from what.

use super::attempt::Attempt;
use super::doubt::Doubt;
use super::placement::Placement;
use super::prediction::Prediction;
use super::{Failure, FailureReason, OdometryKnobs, Outcome, RefinementReport, uncertainty};
use crate::anytime::ErrorEstimate;
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{StopReason, Uncertainty};

/// What [`super::LaserOdometry`] turns into a [`super::Registration`].
pub(super) struct Answer {
    pub(super) outcome: Outcome,
    /// How the robot came here from the answer before is not known.
    pub(super) is_lost: bool,
    pub(super) map_from_base: Pose2,
    pub(super) covariance: PoseCovariance,
    /// What the step from the last answer, or the keyframe, adds to that.
    pub(super) step_covariance: PoseCovariance,
    /// Of a match: what is known of the pose among the keyframes, along the axes of the base.
    pub(super) matched_covariance: Option<PoseCovariance>,
    /// What is known of the pose seen from the keyframe, along the axes of the base.
    pub(super) covariance_to_keyframe: PoseCovariance,
    /// Of a match: it contradicts what the odometry says of the way from the keyframe.
    pub(super) contradicts_odometry: bool,
    pub(super) refinement: Option<RefinementReport>,
    pub(super) predicted_error: ErrorEstimate,
    pub(super) estimated_error: ErrorEstimate,
}

impl Answer {
    /// Of the first scan that others can be matched to.
    pub(super) fn first(map_from_base: Pose2, covariance: PoseCovariance) -> Self {
        let error = ErrorEstimate::of_covariance(&covariance);
        Self {
            outcome: Outcome::First,
            is_lost: false,
            map_from_base,
            covariance,
            step_covariance: covariance,
            matched_covariance: None,
            covariance_to_keyframe: PoseCovariance::zeros(),
            contradicts_odometry: false,
            refinement: None,
            predicted_error: error,
            estimated_error: error,
        }
    }

    /// The prediction, where a match was of no use.
    pub(super) fn predicted(attempt: &Attempt, problem: Failure) -> Self {
        let Attempt { last, prediction: Prediction { motion, covariance: step }, .. } = attempt;
        let (map_from_base, covariance) = attempt.predicted_base();
        let to_keyframe = uncertainty::compound(&Pose2::IDENTITY, &last.covariance_to_keyframe, motion, step);
        let error = ErrorEstimate::of_covariance(step);
        Self {
            outcome: Outcome::Predicted(problem),
            step_covariance: uncertainty::turned(step, last.map_from_base.theta),
            covariance_to_keyframe: uncertainty::turned(&to_keyframe, -motion.theta),
            predicted_error: error,
            estimated_error: error,
            ..Self::first(map_from_base, covariance)
        }
    }

    /// Where a match has found the laser, seen from the keyframe. `known` is what its pairs say; so many rays, `alike`, err together.
    pub(super) fn matched(
        attempt: &Attempt,
        keyframe: &Placement,
        keyframe_from_laser: &Pose2,
        known: Option<&Uncertainty>,
        alike: f64,
        doubt: &Doubt,
    ) -> Self {
        let none = PoseCovariance::zeros();
        let predicted = attempt.prediction.covariance;
        let of_match = known.and_then(|known| known.covariance);
        // The noise of rays averages out over the scans; what they have in common stays, and adds up from keyframe to keyframe, as do
        // the steps between two keyframes where they are all that is known.
        let prior = attempt.prior(keyframe, &attempt.last.covariance_to_keyframe).covariance.try_inverse().unwrap_or_default();
        let with_prior = known.and_then(|known| (known.information? / alike + prior).try_inverse());
        let stays = doubt.factor * with_prior.or(of_match).unwrap_or(predicted);
        let map_from_laser = keyframe.map_from_laser * *keyframe_from_laser;
        let of_laser = uncertainty::compound(&keyframe.map_from_laser, &keyframe.covariance, keyframe_from_laser, &stays);
        let laser_from_base = attempt.base_from_laser.inverse();
        let map_from_base = map_from_laser * laser_from_base;
        let of_base = |of_laser: &PoseCovariance| {
            let of_base = uncertainty::compound(keyframe_from_laser, of_laser, &laser_from_base, &none);
            uncertainty::turned(&of_base, -(*keyframe_from_laser * laser_from_base).theta)
        };
        let covariance = uncertainty::compound(&map_from_laser, &of_laser, &laser_from_base, &none) + doubt.covariance;
        Self {
            outcome: Outcome::Matched,
            step_covariance: uncertainty::turned(&of_match.unwrap_or(predicted), keyframe.map_from_laser.theta),
            matched_covariance: of_match.map(|of_match| of_base(&of_match)),
            covariance_to_keyframe: of_base(&stays),
            contradicts_odometry: doubt.is_contradiction,
            predicted_error: ErrorEstimate::of_covariance(&predicted),
            ..Self::first(map_from_base, covariance)
        }
    }
}

/// What came of an attempt.
pub(super) struct Found {
    pub(super) report: RefinementReport,
    pub(super) keyframe_from_laser: Pose2,
    /// The part of the rays that agree, where the pairs tell.
    pub(super) agreement: Option<f64>,
    /// The answer, or why there is none.
    pub(super) answer: Result<Answer, Failure>,
}

/// Why the pose reached is not to be believed, if so.
pub(super) fn problem(report: &RefinementReport, correction: &Pose2, knobs: &OdometryKnobs) -> Option<Failure> {
    let stop_reason = report.stop_reason;
    if stop_reason.is_failure() {
        return Some(match stop_reason {
            StopReason::Singular => Failure::new(FailureReason::Singular, "the correspondences determine no pose"),
            _ => Failure::new(
                FailureReason::TooFewCorrespondences,
                format!("too few correspondences: the scan of {} rays does not fit the reference", report.rays),
            ),
        });
    }
    if report.iterations == 0 {
        return Some(match stop_reason {
            StopReason::Interrupted => {
                Failure::new(FailureReason::Interrupted, "the answer was called for before the first iteration")
            }
            _ => Failure::new(FailureReason::NoTime, "the time budget leaves no time for an iteration"),
        });
    }
    if correction.distance() > knobs.max_correction_distance || correction.theta.abs() > knobs.max_correction_angle {
        let text = format!(
            "the match corrects the prediction by {:.2} m and {:.1} degrees: more than max_correction_distance or max_correction_angle",
            correction.distance(),
            correction.theta.abs().to_degrees()
        );
        return Some(Failure::new(FailureReason::CorrectionTooLarge, text));
    }
    None
}
