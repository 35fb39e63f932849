//! The result of processing one scan, before it updates the state: a pose, its uncertainty and its origin.

use super::inconsistency::Inconsistency;
use super::keyframe_pose::KeyframePose;
use super::match_problem::MatchProblem;
use super::prediction::Prediction;
use super::scale_error::ScaleJacobian;
use super::{Failure, Outcome, RefinementReport, uncertainty};
use crate::anytime::ErrorEstimate;
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::Uncertainty;

/// A pose that [`super::LaserOdometry`] turns into a [`super::Registration`].
pub(super) struct PoseEstimate {
    pub(super) outcome: Outcome,
    /// The motion from the previous estimate is unknown.
    pub(super) is_lost: bool,
    pub(super) map_from_base: Pose2,
    pub(super) covariance: PoseCovariance,
    /// How the scale error of the odometry, which is not in that covariance, moves the base.
    pub(super) by_scale: ScaleJacobian,
    /// The covariance added by the step from the previous estimate or from the keyframe.
    pub(super) step_covariance: PoseCovariance,
    /// Matches only: covariance of the pose relative to the keyframes, along the axes of the base.
    pub(super) matched_covariance: Option<PoseCovariance>,
    /// Covariance of the pose relative to the keyframe, along the axes of the base.
    pub(super) covariance_to_keyframe: PoseCovariance,
    /// Matches only: the match contradicts the odometry over the last seconds.
    pub(super) contradicts_odometry: bool,
    pub(super) refinement: Option<RefinementReport>,
    pub(super) predicted_error: ErrorEstimate,
    pub(super) estimated_error: ErrorEstimate,
}

impl PoseEstimate {
    /// The estimate for the first scan, which becomes a reference.
    pub(super) fn first(map_from_base: Pose2, covariance: PoseCovariance) -> Self {
        let error = ErrorEstimate::of_covariance(&covariance);
        Self {
            outcome: Outcome::First,
            is_lost: false,
            map_from_base,
            covariance,
            by_scale: ScaleJacobian::NONE,
            step_covariance: covariance,
            matched_covariance: None,
            covariance_to_keyframe: PoseCovariance::zeros(),
            contradicts_odometry: false,
            refinement: None,
            predicted_error: error,
            estimated_error: error,
        }
    }

    /// A predicted pose, for a scan without a match. `error`: that of the prediction.
    pub(super) fn unmatched(failure: Failure, map_from_base: Pose2, covariance: PoseCovariance, error: ErrorEstimate) -> Self {
        let outcome = Outcome::Predicted(failure);
        Self { outcome, predicted_error: error, estimated_error: error, ..Self::first(map_from_base, covariance) }
    }

    /// The prediction, for a scan whose match failed.
    pub(super) fn predicted(problem: &MatchProblem, failure: Failure) -> Self {
        let MatchProblem { previous, prediction: Prediction { motion, covariance: step }, .. } = problem;
        let to_keyframe = uncertainty::compound(&Pose2::IDENTITY, &previous.covariance_to_keyframe, motion, step);
        let error = ErrorEstimate::of_covariance(step);
        Self {
            by_scale: problem.predicted_by_scale(),
            step_covariance: uncertainty::rotated(step, previous.map_from_base.theta),
            covariance_to_keyframe: uncertainty::rotated(&to_keyframe, -motion.theta),
            ..Self::unmatched(failure, problem.predicted_pose(), problem.predicted_covariance(), error)
        }
    }

    /// The estimate for a match that puts the laser at `keyframe_from_laser`. `match_uncertainty` is that by its pairs, of which
    /// each `correlated` rays have errors in common.
    pub(super) fn matched(
        problem: &MatchProblem,
        keyframe: &KeyframePose,
        keyframe_from_laser: &Pose2,
        match_uncertainty: Option<&Uncertainty>,
        correlated: f64,
        inconsistency: &Inconsistency,
    ) -> Self {
        let none = PoseCovariance::zeros();
        let predicted = problem.prediction.covariance;
        let match_covariance = match_uncertainty.and_then(|known| known.covariance);
        // Independent noise of rays averages out over the scans. Common errors remain and add up from keyframe to keyframe, as do
        // the steps between two keyframes if nothing else is known.
        let prior =
            problem.prior(keyframe, &problem.previous.covariance_to_keyframe).covariance.try_inverse().unwrap_or_default();
        let with_prior = match_uncertainty.and_then(|known| (known.information? / correlated + prior).try_inverse());
        let common_covariance = inconsistency.scale * with_prior.or(match_covariance).unwrap_or(predicted);
        let map_from_laser = keyframe.map_from_laser * *keyframe_from_laser;
        let laser_covariance =
            uncertainty::compound(&keyframe.map_from_laser, &keyframe.covariance, keyframe_from_laser, &common_covariance);
        let laser_from_base = problem.base_from_laser.inverse();
        let map_from_base = map_from_laser * laser_from_base;
        let to_base = |laser_covariance: &PoseCovariance| {
            let base_covariance = uncertainty::compound(keyframe_from_laser, laser_covariance, &laser_from_base, &none);
            uncertainty::rotated(&base_covariance, -(*keyframe_from_laser * laser_from_base).theta)
        };
        let covariance =
            uncertainty::compound(&map_from_laser, &laser_covariance, &laser_from_base, &none) + inconsistency.covariance;
        let prior_weight = with_prior.map_or_else(PoseCovariance::zeros, |with_prior| {
            let rotation = uncertainty::rotation(keyframe.map_from_laser.theta);
            rotation * with_prior * prior * rotation.transpose()
        });
        let from = |pose: &Pose2| map_from_base.translation() - pose.translation();
        let predicted_by_scale = problem.predicted_by_scale().at(from(&problem.predicted_pose()));
        let by_scale =
            ScaleJacobian::fused(keyframe.by_scale.at(from(&keyframe.map_from_laser)), predicted_by_scale, &prior_weight);
        Self {
            outcome: Outcome::Matched,
            by_scale,
            step_covariance: uncertainty::rotated(&match_covariance.unwrap_or(predicted), keyframe.map_from_laser.theta),
            matched_covariance: match_covariance.map(|match_covariance| to_base(&match_covariance)),
            covariance_to_keyframe: to_base(&common_covariance),
            contradicts_odometry: inconsistency.is_contradiction,
            predicted_error: ErrorEstimate::of_covariance(&predicted),
            ..Self::first(map_from_base, covariance)
        }
    }

    /// The pose as that of a keyframe.
    pub(super) fn keyframe_pose(&self, base_from_laser: &Pose2) -> KeyframePose {
        let (map_from_base, none) = (self.map_from_base, PoseCovariance::zeros());
        let map_from_laser = map_from_base * *base_from_laser;
        KeyframePose {
            map_from_laser,
            base_from_laser: *base_from_laser,
            covariance: uncertainty::compound(&map_from_base, &self.covariance, base_from_laser, &none),
            by_scale: self.by_scale.at(map_from_laser.translation() - map_from_base.translation()),
            step_covariance: self.step_covariance,
        }
    }
}
