//! Inflates the covariance of a match that is inconsistent with other knowledge of the motion, since it is unknown which of the
//! two is wrong: moving people around the robot can drag a match along, and wheels can slip.

use super::prediction::Prediction;
use super::source_noise::{SourceNoise, normalized_innovation};
use super::uncertainty::rotated;
use crate::geometry::{Pose2, PoseCovariance};

/// How to inflate the covariance of a match.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inconsistency {
    /// Factor for the covariance of the match.
    pub(super) scale: f64,
    /// Covariance to add to that of the pose, along the axes of the map.
    pub(super) covariance: PoseCovariance,
    /// One of the two must be wrong.
    pub(super) is_contradiction: bool,
}

/// A difference of more standard deviations than this is a contradiction.
const CONTRADICTION_GATE: f64 = 3.0;

impl Inconsistency {
    /// Compares the step `measured` since the previous scan with the one by odometry, `predicted`. `noise` is the learned noise
    /// of the odometry.
    pub(super) fn of_step(noise: SourceNoise, predicted: Option<&Prediction>, measured: &Pose2) -> Self {
        let deviation = predicted.map_or(0.0, |predicted| normalized_innovation(predicted, measured));
        Self { scale: noise.inflation(deviation), covariance: PoseCovariance::zeros(), is_contradiction: false }
    }

    /// Also compares a motion of the match with another prediction of it, both in the frame of a base with `heading` on the map.
    /// The pose may be wrong by their difference. Compared since the last keyframe, this reveals small step errors that always
    /// have the same sign.
    pub(super) fn and_against(self, predicted: &Prediction, measured: &Pose2, heading: f64) -> Self {
        // Differences within one standard deviation are consistent; beyond that the weight grows with the difference.
        let deviation = normalized_innovation(predicted, measured);
        let weight = 1.0 - deviation.max(1.0).powi(-2);
        let difference = predicted.motion.difference(measured);
        let covariance = self.covariance + rotated(&(weight * difference * difference.transpose()), heading);
        Self { covariance, is_contradiction: deviation > CONTRADICTION_GATE, ..self }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    /// The inconsistency of a match that moved by `measured` m since a keyframe that faces north, while odometry moved by
    /// `predicted` m.
    fn inconsistency(predicted: f64, measured: f64) -> Inconsistency {
        let predicted = Prediction::by_wheels(Pose2::new(predicted, 0.0, 0.0), 0.1);
        let measured = Pose2::new(measured, 0.0, 0.0);
        Inconsistency::of_step(SourceNoise::default(), Some(&predicted), &measured).and_against(&predicted, &measured, FRAC_PI_2)
    }

    #[test]
    fn a_match_that_contradicts_the_odometry_may_be_wrong_by_the_difference() {
        let Inconsistency { scale, covariance, is_contradiction } = inconsistency(0.4, 0.0);
        assert!(is_contradiction);
        assert!(scale > 10.0 && (covariance.m22.sqrt() - 0.4).abs() < 0.05, "{scale} {covariance}");
        assert!(covariance.m11 < 1e-9 && covariance.m33 < 1e-9, "only along the path: {covariance}");
    }

    #[test]
    fn a_difference_within_the_error_of_odometry_is_consistent() {
        let Inconsistency { scale, covariance, is_contradiction } = inconsistency(0.4, 0.37);
        assert!(!is_contradiction);
        assert!((scale - 1.0).abs() < 1e-9 && covariance.norm() < 1e-9, "{scale} {covariance}");
    }
}
