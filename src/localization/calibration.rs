//! What odometry errs by steadily: a wheel that is smaller than it is taken to be makes every way too long, in proportion.
//!
//! Errors from scan to scan average out, steady ones do not: where scans tell little of the way, as in a corridor, a cloud that is moved too
//! far each time ends up ahead of the robot by many times what it takes itself to be off. The corrections of the scans then have one
//! sign, and their sum is the part that learns.

use crate::geometry::Pose2;

/// Way over which the scale is learned, m: an error of a decimetre in the pose, as it comes and goes, is worth a hundredth.
const REACH: f64 = 10.0;
/// No odometry is off by more than this part.
const MOST: f64 = 0.2;
/// On a shorter way between two scans than this, m, a correction is not of the odometry's making.
const SHORTEST: f64 = 0.005;

/// The learned scale of distances.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Calibration {
    /// Part by which distances are longer than odometry says.
    scale: f64,
}

impl Calibration {
    /// The motion that is meant where odometry says `motion`.
    pub(super) fn motion(self, motion: &Pose2) -> Pose2 {
        Pose2::new(motion.x * (1.0 + self.scale), motion.y * (1.0 + self.scale), motion.theta)
    }

    /// After `motion`, scans say that the robot is at `correction`, seen from where it was predicted.
    pub(super) fn learn(&mut self, motion: &Pose2, correction: &Pose2) {
        if motion.x.abs() >= SHORTEST {
            let along = correction.x * motion.x.signum();
            self.scale = (self.scale + along / REACH).clamp(-MOST, MOST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_error_is_learned_and_noise_is_not() {
        // Odometry says 5 % too much; a scan takes back a fiftieth of the error, as in a corridor.
        for (says, noise) in [(1.05, 0.0), (1.0, 0.05), (-1.05, 0.0)] {
            let (mut calibration, mut error) = (Calibration::default(), 0.0);
            for scan in 0..2000 {
                let odometry = Pose2::new(0.06 * says, 0.0, 0.0);
                error += calibration.motion(&odometry).x - 0.06_f64.copysign(says);
                let seen = error + if scan % 2 == 0 { noise } else { -noise };
                error -= 0.02 * seen;
                calibration.learn(&odometry, &Pose2::new(-0.02 * seen, 0.0, 0.0));
            }
            assert!(error.abs() < 0.002, "{says}: {error} m");
            let expected = 1.0 / f64::abs(says) - 1.0;
            assert!((calibration.scale - expected).abs() < 0.005, "{says}: {}", calibration.scale);
        }
        let mut at_rest = Calibration::default();
        at_rest.learn(&Pose2::IDENTITY, &Pose2::new(1.0, 0.0, 0.0));
        assert!(at_rest.scale.abs() < 1e-12);
    }
}
