//! What is doubtful of a match that contradicts what else is known of the motion: nobody knows which of the two is wrong. People who walk
//! beside the robot pull a match along as wheels do that slip.

use super::prediction::Prediction;
use super::source_noise::{SourceNoise, deviation, offset};
use super::uncertainty::turned;
use crate::geometry::{Pose2, PoseCovariance};

/// How much more a match may err than its pairs say.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doubt {
    /// So many times the covariance that its pairs claim.
    pub(super) factor: f64,
    /// And this besides: the covariance of the pose, along the axes of the map.
    pub(super) covariance: PoseCovariance,
    /// One of the two must be wrong.
    pub(super) is_contradiction: bool,
}

/// A difference of so many standard deviations is a contradiction.
const CONTRADICTION: f64 = 3.0;

impl Doubt {
    /// Of a match by which the base has moved by `found` since the last scan, where odometry, which has been wrong lately by `noise`, says
    /// `said`.
    pub(super) fn of_step(noise: SourceNoise, said: Option<&Prediction>, found: &Pose2) -> Self {
        let deviation = said.map_or(0.0, |said| deviation(said, found));
        Self { factor: noise.doubt(deviation), covariance: PoseCovariance::zeros(), is_contradiction: false }
    }

    /// The same, where the match has found a motion and something else says another one, both from where the base was turned by `heading`
    /// on the map: what the two differ by, the pose may be wrong by. Since the last keyframe that shows steps which err by little each, but
    /// always to the same side.
    pub(super) fn against(self, said: &Prediction, found: &Pose2, heading: f64) -> Self {
        // Within a standard deviation they do not contradict one another; beyond, the more the difference counts.
        let deviation = deviation(said, found);
        let share = 1.0 - deviation.max(1.0).powi(-2);
        let difference = offset(said, found);
        let covariance = self.covariance + turned(&(share * difference * difference.transpose()), heading);
        Self { covariance, is_contradiction: deviation > CONTRADICTION, ..self }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::odometry::uncertainty::of_wheels;

    /// What is doubtful when odometry says that the robot drove on by `said` m since a keyframe that looks north, and the match `found`.
    fn doubt(said: f64, found: f64) -> Doubt {
        let motion = Pose2::new(said, 0.0, 0.0);
        let said = Prediction { motion, covariance: of_wheels(&motion, 0.1) };
        let found = Pose2::new(found, 0.0, 0.0);
        Doubt::of_step(SourceNoise::default(), Some(&said), &found).against(&said, &found, FRAC_PI_2)
    }

    #[test]
    fn a_match_that_contradicts_the_odometry_may_be_wrong_by_the_difference() {
        let Doubt { factor, covariance, is_contradiction } = doubt(0.4, 0.0);
        assert!(is_contradiction);
        assert!(factor > 10.0 && (covariance.m22.sqrt() - 0.4).abs() < 0.05, "{factor} {covariance}");
        assert!(covariance.m11 < 1e-9 && covariance.m33 < 1e-9, "along the way alone: {covariance}");
    }

    #[test]
    fn what_odometry_may_err_by_contradicts_nothing() {
        let Doubt { factor, covariance, is_contradiction } = doubt(0.4, 0.37);
        assert!(!is_contradiction);
        assert!((factor - 1.0).abs() < 1e-9 && covariance.norm() < 1e-9, "{factor} {covariance}");
    }
}
