//! Recognises places of earlier on the path.
//!
//! Every new keyframe is matched to the keyframes of long ago that should be around. Where the path has hardly drifted, one match
//! says all. Where it has, a wrong place may look right for once: only several keyframes in a row that agree on where the path has
//! drifted to are believed (the consistency of loop closures in a chain, as in Olson 2009, "Recognizing places using spectrally
//! clustered local matches"). What is believed puts the path right as far as the match knows better than the path (the Kalman filter's
//! update): along a corridor it may know nothing.

use std::ops::RangeInclusive;

use nalgebra::Matrix3;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::SearchWindow;

/// How far a path may have drifted per metre: that far the earlier keyframes are looked for, m ...
const DRIFT_PER_METRE: f64 = 0.02;
/// ... but within these limits, m, ...
const DRIFT: RangeInclusive<f64> = 0.3..=4.0;
/// ... and rad ...
const TURN_DRIFT_PER_METRE: f64 = 0.001;
/// ... within these.
const TURN_DRIFT: RangeInclusive<f64> = 0.02..=0.15;
/// Where this part of the rays agrees at the place that the path says, no other place is looked for.
const DOUBTFUL: f64 = 0.8;
/// Least part of the rays that agree.
const AGREEING: f64 = 0.7;
/// A match says where a place is when it knows to within this, m: standard deviation. Along a corridor few do. From 1.5 to 2 cm all logs do
/// alike; at 1 cm half of the scans of aces find too few loops, at 5 cm intel's relations are a third worse.
const CLEAR: f64 = 0.017;
/// A path has hardly drifted by less than this, m ...
const SMALL_DRIFT: f64 = 0.3;
/// ... and rad.
const SMALL_TURN_DRIFT: f64 = 0.05;
/// Keyframes in a row that must agree on a drift that is not small: to within this, m ...
const CONSISTENT: f64 = 0.1;
/// ... and rad.
const CONSISTENT_TURN: f64 = 0.0175;
/// So many.
const IN_A_ROW: usize = 3;

/// What a match of a new keyframe to earlier ones says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    /// Pose of the keyframe's laser by the path.
    pub(super) by_path: Pose2,
    /// The same by the earlier keyframes.
    pub(super) by_earlier: Pose2,
    /// Part of the rays that agree with them.
    pub(super) agreement: f64,
    /// What the match knows of that pose: the inverse of its covariance, in the map frame; nothing along directions that it leaves open.
    pub(super) information: Matrix3<f64>,
}

impl Sighting {
    /// Takes poses from where the path has them to where the earlier keyframes do.
    fn correction(&self) -> Pose2 {
        self.by_earlier * self.by_path.inverse()
    }

    /// Whether it says where the keyframe was taken, and not just where along a wall it may have been.
    fn is_clear(&self) -> bool {
        self.information.try_inverse().is_some_and(|known| (known.m11 + known.m22).sqrt() < CLEAR)
    }

    /// Where the keyframe was taken by all that is known, and the covariance, in the map frame. `drift`: covariance of the path's pose,
    /// seen from the earlier keyframes; so many times that where the two contradict one another (Mehra 1970).
    pub(super) fn weighed(&self, drift: &PoseCovariance) -> (Pose2, PoseCovariance) {
        let Pose2 { x, y, theta } = self.by_path;
        let offset = self.by_path.difference(&self.by_earlier);
        // I (D I + E)^-1 is (D + I^-1)^-1, also where the information has no inverse.
        let of_both = |drift: &PoseCovariance| {
            let inverse = (drift * self.information + Matrix3::identity()).try_inverse();
            inverse.map_or_else(Matrix3::zeros, |inverse| self.information * inverse)
        };
        let drift = drift * (offset.dot(&(of_both(drift) * offset)) / 3.0).max(1.0);
        let gain = drift * of_both(&drift);
        let change = gain * offset;
        (Pose2::new(x + change.x, y + change.y, theta + change.z), drift - gain * drift)
    }
}

/// Where to look for earlier keyframes when the path has been free to drift for `way`, m.
pub(super) fn window(way: f64) -> SearchWindow {
    let within = |drift: f64, limits: &RangeInclusive<f64>| drift.clamp(*limits.start(), *limits.end());
    SearchWindow {
        distance: within(DRIFT_PER_METRE * way, &DRIFT),
        angle: within(TURN_DRIFT_PER_METRE * way, &TURN_DRIFT),
        doubtful_agreement: DOUBTFUL,
    }
}

/// Judges sightings, of one keyframe after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct LoopCloser {
    /// Corrections that the last keyframes ask for, which agree.
    corrections: Vec<Pose2>,
}

impl LoopCloser {
    /// The last keyframe has seen nothing of earlier ones.
    pub(super) fn forget(&mut self) {
        self.corrections.clear();
    }

    /// Whether to believe what the next keyframe has seen.
    pub(super) fn believes(&mut self, sighting: &Sighting) -> bool {
        if !sighting.is_clear() {
            return false;
        }
        let is_small = is_within(&sighting.by_path, &sighting.by_earlier, SMALL_DRIFT, SMALL_TURN_DRIFT);
        if sighting.agreement < AGREEING || is_small {
            self.forget();
            return sighting.agreement >= AGREEING;
        }
        let agrees = |other: &Pose2| is_within(&(*other * sighting.by_path), &sighting.by_earlier, CONSISTENT, CONSISTENT_TURN);
        if !self.corrections.iter().all(agrees) {
            self.forget();
        }
        self.corrections.push(sighting.correction());
        let is_believed = self.corrections.len() >= IN_A_ROW;
        if is_believed {
            self.forget();
        }
        is_believed
    }
}

fn is_within(a: &Pose2, b: &Pose2, distance: f64, angle: f64) -> bool {
    let motion = a.between(b);
    motion.distance() < distance && motion.theta.abs() < angle
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn sighting(way: f64, drift: Pose2) -> Sighting {
        let by_path = Pose2::new(way, 1.0, 0.3);
        let information = Matrix3::from_diagonal(&Vector3::new(1e4, 1e4, 1e6));
        Sighting { by_path, by_earlier: drift * by_path, agreement: 0.9, information }
    }

    /// The same of a keyframe that has seen no more than a wall along x.
    fn unclear(sighting: &Sighting) -> Sighting {
        Sighting { information: Matrix3::from_diagonal(&Vector3::new(0.0, 1e4, 1e6)), ..*sighting }
    }

    fn believed(sightings: impl IntoIterator<Item = Sighting>) -> Vec<bool> {
        let mut closer = LoopCloser::default();
        sightings.into_iter().map(|sighting| closer.believes(&sighting)).collect()
    }

    #[test]
    fn a_small_drift_is_believed_at_once() {
        let small = sighting(3.0, Pose2::new(0.1, -0.1, 0.01));
        assert_eq!(believed([small, Sighting { agreement: 0.5, ..small }, unclear(&small)]), [true, false, false]);
    }

    #[test]
    fn a_great_drift_takes_keyframes_in_a_row_that_agree() {
        let drift = Pose2::new(1.0, 0.5, 0.03);
        let (right, wrong) = (|way| sighting(way, drift), |way| sighting(way, Pose2::new(-0.7, 0.0, 0.0)));
        assert_eq!(believed([right(0.0), right(0.4), right(0.8)]), [false, false, true]);
        assert_eq!(believed([right(0.0), wrong(0.4), right(0.8), right(1.2), right(1.6)]), [false, false, false, false, true]);
        let seen = [right(0.0), unclear(&right(0.4)), right(0.8), right(1.2)];
        assert_eq!(believed(seen), [false, false, false, true], "what says nothing does not contradict");
    }

    #[test]
    fn the_path_is_put_right_as_far_as_the_match_knows_better() {
        let seen = sighting(3.0, Pose2::new(0.1, -0.1, 0.01));
        let drift = PoseCovariance::from_diagonal(&Vector3::new(0.04, 0.04, 1e-3));
        let (pose, covariance) = seen.weighed(&drift);
        assert!(pose.between(&seen.by_earlier).distance() < 1e-3 && (covariance.m11 - 1e-4).abs() < 1e-6);
        let (pose, covariance) = unclear(&seen).weighed(&drift);
        assert!((pose.x - seen.by_path.x).abs() < 1e-9 && (pose.y - seen.by_earlier.y).abs() < 1e-3);
        assert!((covariance.m11 - drift.m11).abs() < 1e-9, "nothing is learned of how far along");
    }

    #[test]
    fn a_path_that_claims_to_have_drifted_less_is_not_believed() {
        let seen = sighting(3.0, Pose2::new(0.1, 0.0, 0.0));
        let claimed = PoseCovariance::from_diagonal(&Vector3::repeat(1e-6));
        let (pose, covariance) = seen.weighed(&claimed);
        assert!(pose.x - seen.by_path.x > 0.02, "it would be a millimetre: {pose:?}");
        assert!(covariance.m11 > 10.0 * claimed.m11, "{covariance}");
    }
}
