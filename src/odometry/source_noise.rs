//! Learns how accurate each source of motion is from the matches. Wheels that slip, or that count up while the robot reverses,
//! are wrong for seconds (the latter happens in the fr079 log), and a velocity is meaningless if stamps jitter. A prior that is
//! wrong scan after scan but claims to be accurate drags the matches along until nothing fits.
//!
//! The covariance of a source's model is multiplied by the ratio of the latest squared errors to it: noise adaptation of a Kalman
//! filter by its innovations (Mehra 1970), restricted to adding noise.

use super::prediction::Prediction;
use super::registration::RejectedSources;
use crate::geometry::Pose2;

/// Noise factor from which a source is rejected: its latest steps err by three times what its model claims.
const REJECTION_FACTOR: f64 = 9.0;
/// Weight of the latest step in the learned noise: after four steps most of it is new.
const UPDATE_WEIGHT: f64 = 0.25;
/// Maximum normalized innovation of a step: larger ones are clipped, so that a single jump is forgotten within a dozen steps.
const MAX_INNOVATION: f64 = 20.0;

/// Squared Mahalanobis distance above which odometry contradicts the velocity: 1 % of correct ones exceed it (chi-squared, three
/// degrees of freedom). From 6 to 16 works equally well, except that lower values are far better if stamps jitter.
const GATE: f64 = 11.3;

/// Learned noise of one source.
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
    /// Factor for the covariance of the source's model, at least 1.
    pub(super) fn factor(self) -> f64 {
        self.factor
    }

    /// Whether the latest steps contradict the source, so that it gets almost no weight.
    pub(super) fn is_rejected(self) -> bool {
        self.factor >= REJECTION_FACTOR
    }

    /// Factor by which to inflate the covariance of a match that differs from the source by this normalized innovation, since it
    /// is unknown which of the two is wrong.
    pub(super) fn inflation(self, normalized_innovation: f64) -> f64 {
        self.factor.max(normalized_innovation.min(MAX_INNOVATION).powi(2))
    }

    /// Updates the noise by the normalized innovation of one step.
    pub(super) fn update(&mut self, normalized_innovation: f64) {
        let squared = normalized_innovation.min(MAX_INNOVATION).powi(2);
        self.factor = (self.factor + UPDATE_WEIGHT * (squared - self.factor)).max(1.0);
    }
}

/// Learned noise of each source of motion.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LearnedNoise {
    /// The constant-velocity prediction.
    pub(super) velocity: SourceNoise,
    pub(super) odometry: SourceNoise,
    pub(super) imu: SourceNoise,
}

impl LearnedNoise {
    pub(super) fn rejected_sources(&self) -> RejectedSources {
        RejectedSources { odometry: self.odometry.is_rejected(), imu: self.imu.is_rejected() }
    }
}

impl Prediction {
    /// The prediction with the learned noise of its source.
    pub(super) fn with_noise(&self, noise: SourceNoise) -> Self {
        Self { covariance: self.covariance * noise.factor(), ..*self }
    }

    /// Checks odometry against the constant-velocity prediction. If the two contradict each other, the wheels lock, spin or are
    /// not reported, because a robot cannot change its velocity that fast. The covariance of the odometry is then multiplied by
    /// the squared Mahalanobis distance. If stamps jitter, the step may have taken the typical time; the velocity then leads to
    /// `typical`.
    pub(super) fn checked_against(&self, by_velocity: &Self, typical: &Self) -> Self {
        let time = by_velocity.motion.difference(&typical.motion);
        let both = Self { covariance: self.covariance + typical.covariance + time * time.transpose(), ..*self };
        let squared = 3.0 * normalized_innovation(&both, &by_velocity.motion).powi(2);
        Self { covariance: self.covariance * if squared > GATE { squared } else { 1.0 }, ..*self }
    }
}

/// Innovation (measured minus predicted motion) in standard deviations of the prediction, as root mean square over its three coordinates.
pub(super) fn normalized_innovation(predicted: &Prediction, measured: &Pose2) -> f64 {
    let error = predicted.motion.difference(measured);
    predicted.covariance.cholesky().map_or(0.0, |known| (error.dot(&known.solve(&error)).max(0.0) / 3.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty;

    fn after(steps: &[(f64, f64)]) -> SourceNoise {
        let mut noise = SourceNoise::default();
        for &(predicted, measured) in steps {
            let predicted = Prediction::by_wheels(Pose2::new(predicted, 0.0, 0.0), 0.2);
            noise.update(normalized_innovation(&predicted, &Pose2::new(measured, 0.0, 0.0)));
        }
        noise
    }

    #[test]
    fn the_noise_is_that_of_the_model_until_errors_are_larger() {
        assert!((after(&[]).factor() - 1.0).abs() < 1e-12);
        assert!((after(&[(0.1, 0.12), (0.1, 0.08), (0.1, 0.12)]).factor() - 1.0).abs() < 1e-12, "typical errors");
        let wrong = [(0.1, -0.1); 12];
        assert!(after(&wrong).factor() > REJECTION_FACTOR && after(&wrong).is_rejected());
        assert!(after(&wrong).factor() > 2.0 * after(&wrong[..1]).factor());
        let right_again = [&wrong[..], &[(0.1, 0.1); 20]].concat();
        assert!(after(&right_again).factor() < 1.2 && !after(&right_again).is_rejected());
    }

    #[test]
    fn wheels_that_stop_abruptly_get_an_inflated_covariance() {
        let prediction = |x: f64, deviation: f64| Prediction {
            motion: Pose2::new(x, 0.0, 0.0),
            covariance: uncertainty::diagonal(deviation, deviation),
        };
        let driving = prediction(0.15, 0.02);
        let fused = |predicted: f64, typical: f64| {
            prediction(predicted, 0.01).checked_against(&driving, &prediction(typical, 0.02)).fused_with(&driving)
        };
        assert!(fused(0.0, 0.15).motion.x > 0.1, "wheels that lock: {}", fused(0.0, 0.15).motion.x);
        assert!(fused(0.11, 0.15).motion.x < 0.12, "wheels that brake: {}", fused(0.11, 0.15).motion.x);
        assert!(fused(0.0, 0.0).motion.x < 0.05, "a stamp that is late: {}", fused(0.0, 0.0).motion.x);
    }

    #[test]
    fn one_jump_is_soon_forgotten() {
        let jump = [&[(0.1, 100.0)][..], &[(0.1, 0.1); 12]].concat();
        assert!(after(&jump).factor() < 5.0, "{}", after(&jump).factor());
    }

    #[test]
    fn rotations_count_too_and_wrap_around() {
        let predicted = Prediction::by_wheels(Pose2::new(0.0, 0.0, 3.0), 0.2);
        assert!(normalized_innovation(&predicted, &Pose2::new(0.0, 0.0, -3.0)) < 1.0);
        assert!(normalized_innovation(&predicted, &Pose2::IDENTITY) > 3.0);
    }
}
