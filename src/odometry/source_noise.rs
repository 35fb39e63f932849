//! Whether a source of motion is to be believed, each judged on its own: wheels that slip, or that count up while the robot backs, say the
//! same wrong thing for seconds (the latter is in the fr079 log). One wrong step is put right by its match; a prior that is wrong scan after scan drags the matches along
//! until they fit nothing.

use nalgebra::Vector3;

use super::attempt::Prediction;
use crate::geometry::{Pose2, wrap_angle};

/// What is this many standard deviations from what a source says contradicts it.
pub(super) const CONTRADICTING: f64 = 5.0;
/// So many matches in a row that contradict it, and it is not believed until one does not.
const ENOUGH: u32 = 2;

/// What the last matches say of a source.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trust {
    contradictions: u32,
}

impl Trust {
    /// Whether to predict by it.
    pub(super) fn is_given(self) -> bool {
        self.contradictions < ENOUGH
    }

    /// What a match makes of what was said of its motion: so many standard deviations it is from that.
    pub(super) fn judge(&mut self, deviation: f64) {
        self.contradictions = if deviation > CONTRADICTING { self.contradictions + 1 } else { 0 };
    }
}

/// Mahalanobis distance of a motion from the one that was said.
pub(super) fn deviation(said: &Prediction, found: &Pose2) -> f64 {
    let Pose2 { x, y, theta } = said.motion;
    let error = Vector3::new(found.x - x, found.y - y, wrap_angle(found.theta - theta));
    said.covariance.cholesky().map_or(0.0, |known| error.dot(&known.solve(&error)).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty;

    fn judged(steps: &[(f64, f64)]) -> bool {
        let mut trust = Trust::default();
        for &(said, found) in steps {
            let motion = Pose2::new(said, 0.0, 0.0);
            let said = Prediction { motion, covariance: uncertainty::of_wheels(&motion) };
            trust.judge(deviation(&said, &Pose2::new(found, 0.0, 0.0)));
        }
        trust.is_given()
    }

    #[test]
    fn odometry_is_believed_until_it_is_contradicted_again_and_again() {
        assert!(judged(&[]));
        assert!(judged(&[(0.1, 0.12), (0.1, 0.08), (0.1, 0.12)]), "as usual");
        assert!(judged(&[(0.1, -0.1)]), "once");
        assert!(judged(&[(0.1, -0.1), (0.1, 0.1), (0.1, -0.1)]), "twice, with an agreement between");
        assert!(!judged(&[(0.1, -0.1), (0.1, -0.1)]));
        assert!(!judged(&[(0.1, -0.1), (0.1, -0.1), (0.1, -0.1)]));
        assert!(judged(&[(0.1, -0.1), (0.1, -0.1), (0.1, 0.1)]), "right again");
    }

    #[test]
    fn turns_contradict_too_and_go_round() {
        let motion = Pose2::new(0.0, 0.0, 3.0);
        let said = Prediction { motion, covariance: uncertainty::of_wheels(&motion) };
        assert!(deviation(&said, &Pose2::new(0.0, 0.0, -3.0)) < 1.0);
        assert!(deviation(&said, &Pose2::IDENTITY) > CONTRADICTING);
    }
}
