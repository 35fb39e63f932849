//! How wrong a source of motion is, learned from the matches, each source for itself: wheels that slip, or that count up while the robot
//! backs, say the same wrong thing for seconds (the latter is in the fr079 log), and a velocity is none where stamps jitter. A prior that
//! is wrong scan after scan and claims to be right drags the matches along until they fit nothing.
//!
//! The covariance that a source's model claims is multiplied by how much the squared errors of the last steps exceed it: the noise
//! adaptive Kalman filter's estimate from innovations (Mehra 1970), that only ever adds noise.

use nalgebra::Vector3;

use super::prediction::Prediction;
use super::registration::Disbelieved;
use crate::geometry::Pose2;

/// A source whose last steps err by three times what its model claims is worth next to nothing.
const DISBELIEVED: f64 = 9.0;
/// Weight of the last step in the learned noise: after four steps most of it is new.
const WEIGHT: f64 = 0.25;
/// A step that errs by more standard deviations than this counts as one that errs by so many: one jump is forgotten within a dozen.
const CLIPPED: f64 = 20.0;

/// Two motions whose difference has a greater square, in standard deviations, contradict one another: one in a hundred does that are right
/// (chi-squared, three degrees of freedom). From 6 to 16 do alike, the less by far where stamps jitter.
const CONTRADICTION: f64 = 11.3;

/// What the last steps say of a source.
#[derive(Clone, Copy, Debug)]
pub(super) struct SourceNoise {
    factor: f64,
}

impl Default for SourceNoise {
    fn default() -> Self {
        Self { factor: 1.0 }
    }
}

impl SourceNoise {
    /// So many times the covariance that its model claims is that of what it says; at least 1.
    pub(super) fn factor(self) -> f64 {
        self.factor
    }

    /// Whether the last steps contradict it: next to nothing is made of what it says.
    pub(super) fn is_disbelieved(self) -> bool {
        self.factor >= DISBELIEVED
    }

    /// So many times its covariance is what a match may err by that differs from the source by so many standard deviations of the source's
    /// model: which of the two is wrong, nobody knows.
    pub(super) fn doubt(self, deviation: f64) -> f64 {
        self.factor.max(deviation.min(CLIPPED).powi(2))
    }

    /// What the matches make of a step: it errs by so many standard deviations of the model, in the mean over its coordinates.
    pub(super) fn judge(&mut self, deviation: f64) {
        let seen = deviation.min(CLIPPED).powi(2);
        self.factor = (self.factor + WEIGHT * (seen - self.factor)).max(1.0);
    }
}

/// How wrong each source of motion has been lately.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LearnedNoise {
    /// The robot going on as it did.
    pub(super) velocity: SourceNoise,
    pub(super) odometry: SourceNoise,
    pub(super) imu: SourceNoise,
}

impl LearnedNoise {
    pub(super) fn disbelieved(&self) -> Disbelieved {
        Disbelieved { odometry: self.odometry.is_disbelieved(), imu: self.imu.is_disbelieved() }
    }
}

impl Prediction {
    /// With the noise that was learned of its source.
    pub(super) fn with_noise(&self, noise: SourceNoise) -> Self {
        Self { covariance: self.covariance * noise.factor(), ..*self }
    }

    /// What wheels say, weighed by how the robot was driving: where the two contradict one another, the wheels lock, spin or are not heard of,
    /// for a body is too heavy to change its velocity like that. Their standard deviation is then that from the velocity. Where stamps jitter
    /// the step may have taken as long as any: then the robot would be where it is `usually`.
    pub(super) fn doubted_by(&self, expected: &Self, usually: &Self) -> Self {
        let time = offset(expected, &usually.motion);
        let both = Self { covariance: self.covariance + usually.covariance + time * time.transpose(), ..*self };
        let squared = 3.0 * deviation(&both, &expected.motion).powi(2);
        Self { covariance: self.covariance * if squared > CONTRADICTION { squared } else { 1.0 }, ..*self }
    }
}

/// By how much a motion differs from the one that was said: m, m, rad, along the axes of its start.
pub(super) fn offset(said: &Prediction, found: &Pose2) -> Vector3<f64> {
    said.motion.difference(found)
}

/// Standard deviations, in the mean over the coordinates, of a motion from the one that was said.
pub(super) fn deviation(said: &Prediction, found: &Pose2) -> f64 {
    let error = offset(said, found);
    said.covariance.cholesky().map_or(0.0, |known| (error.dot(&known.solve(&error)).max(0.0) / 3.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty;

    fn after(steps: &[(f64, f64)]) -> SourceNoise {
        let mut noise = SourceNoise::default();
        for &(said, found) in steps {
            let motion = Pose2::new(said, 0.0, 0.0);
            let said = Prediction { motion, covariance: uncertainty::of_wheels(&motion, 0.2) };
            noise.judge(deviation(&said, &Pose2::new(found, 0.0, 0.0)));
        }
        noise
    }

    #[test]
    fn noise_is_what_the_model_claims_until_steps_err_by_more() {
        assert!((after(&[]).factor() - 1.0).abs() < 1e-12);
        assert!((after(&[(0.1, 0.12), (0.1, 0.08), (0.1, 0.12)]).factor() - 1.0).abs() < 1e-12, "as usual");
        let wrong = [(0.1, -0.1); 12];
        assert!(after(&wrong).factor() > DISBELIEVED && after(&wrong).is_disbelieved());
        assert!(after(&wrong).factor() > 2.0 * after(&wrong[..1]).factor());
        let right_again = [&wrong[..], &[(0.1, 0.1); 20]].concat();
        assert!(after(&right_again).factor() < 1.2 && !after(&right_again).is_disbelieved());
    }

    #[test]
    fn wheels_that_stop_at_once_are_doubted() {
        let known = |x: f64, deviation: f64| Prediction {
            motion: Pose2::new(x, 0.0, 0.0),
            covariance: uncertainty::diagonal(deviation, deviation),
        };
        let driving = known(0.15, 0.02);
        let weighed = |said: f64, usually: f64| known(said, 0.01).doubted_by(&driving, &known(usually, 0.02)).and(&driving);
        assert!(weighed(0.0, 0.15).motion.x > 0.1, "wheels that lock: {}", weighed(0.0, 0.15).motion.x);
        assert!(weighed(0.11, 0.15).motion.x < 0.12, "wheels that brake: {}", weighed(0.11, 0.15).motion.x);
        assert!(weighed(0.0, 0.0).motion.x < 0.05, "a stamp that is late: {}", weighed(0.0, 0.0).motion.x);
    }

    #[test]
    fn one_jump_is_soon_forgotten() {
        let jump = [&[(0.1, 100.0)][..], &[(0.1, 0.1); 12]].concat();
        assert!(after(&jump).factor() < 5.0, "{}", after(&jump).factor());
    }

    #[test]
    fn turns_contradict_too_and_go_round() {
        let motion = Pose2::new(0.0, 0.0, 3.0);
        let said = Prediction { motion, covariance: uncertainty::of_wheels(&motion, 0.2) };
        assert!(deviation(&said, &Pose2::new(0.0, 0.0, -3.0)) < 1.0);
        assert!(deviation(&said, &Pose2::IDENTITY) > 3.0);
    }
}
