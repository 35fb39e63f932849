//! Recognises places of earlier on the path.
//!
//! Every new keyframe is matched to the keyframes of long ago that should be around. Where the path has hardly drifted, one match
//! says all. Where it has, a wrong place may look right for once: only several keyframes in a row that agree on where the path has
//! drifted to are believed (the consistency of loop closures in a chain, as in Olson 2009, "Recognizing places using spectrally
//! clustered local matches").

use crate::geometry::Pose2;
use crate::matching::SearchWindow;

/// How far a path may have drifted: that far the earlier keyframes are looked for, m ...
const DRIFT: f64 = 2.0;
/// ... and rad.
const TURN_DRIFT: f64 = 0.09;
/// Where this part of the rays agrees at the place that the path says, no other place is looked for.
const DOUBTFUL: f64 = 0.8;
/// Least part of the rays that agree.
const AGREEING: f64 = 0.7;
/// Of a match of a greater condition number it is not clear where along a wall it belongs.
const GREATEST_CONDITION: f64 = 50.0;
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
    /// Of the match.
    pub(super) condition_number: f64,
}

impl Sighting {
    /// Takes poses from where the path has them to where the earlier keyframes do.
    fn correction(&self) -> Pose2 {
        self.by_earlier * self.by_path.inverse()
    }
}

/// What is made of a sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Recognition {
    /// The place is that of the earlier keyframes.
    SamePlace,
    /// It is, and the path has drifted: this takes poses to where they belong.
    Drifted(Pose2),
}

/// Where to look for earlier keyframes.
pub(super) fn window() -> SearchWindow {
    SearchWindow { distance: DRIFT, angle: TURN_DRIFT, doubtful_agreement: DOUBTFUL }
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

    /// What the next keyframe has seen.
    pub(super) fn judge(&mut self, sighting: &Sighting) -> Option<Recognition> {
        let correction = sighting.correction();
        let is_clear = sighting.condition_number < GREATEST_CONDITION;
        if sighting.agreement < AGREEING {
            self.forget();
            return None;
        }
        if is_within(&sighting.by_path, &sighting.by_earlier, SMALL_DRIFT, SMALL_TURN_DRIFT) {
            self.forget();
            return Some(if is_clear { Recognition::Drifted(correction) } else { Recognition::SamePlace });
        }
        let agrees = |other: &Pose2| is_within(&(*other * sighting.by_path), &sighting.by_earlier, CONSISTENT, CONSISTENT_TURN);
        if !is_clear || !self.corrections.iter().all(agrees) {
            self.forget();
        }
        if is_clear {
            self.corrections.push(correction);
        }
        if self.corrections.len() < IN_A_ROW {
            return None;
        }
        self.forget();
        Some(Recognition::Drifted(correction))
    }
}

fn is_within(a: &Pose2, b: &Pose2, distance: f64, angle: f64) -> bool {
    let motion = a.between(b);
    motion.distance() < distance && motion.theta.abs() < angle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(way: f64, drift: Pose2) -> Sighting {
        let by_path = Pose2::new(way, 1.0, 0.3);
        Sighting { by_path, by_earlier: drift * by_path, agreement: 0.9, condition_number: 10.0 }
    }

    fn judge(sightings: impl IntoIterator<Item = Sighting>) -> Vec<bool> {
        let mut closer = LoopCloser::default();
        sightings.into_iter().map(|sighting| closer.judge(&sighting).is_some()).collect()
    }

    #[test]
    fn a_small_drift_is_believed_at_once_and_corrected_where_the_match_is_clear() {
        let small = Pose2::new(0.1, -0.1, 0.01);
        let clear = sighting(3.0, small);
        let Some(Recognition::Drifted(correction)) = LoopCloser::default().judge(&clear) else { panic!("no correction") };
        assert!((correction * clear.by_path).between(&clear.by_earlier).distance() < 1e-12);
        let along_a_wall = Sighting { condition_number: f64::INFINITY, ..clear };
        assert_eq!(LoopCloser::default().judge(&along_a_wall), Some(Recognition::SamePlace));
        assert_eq!(LoopCloser::default().judge(&Sighting { agreement: 0.5, ..clear }), None);
    }

    #[test]
    fn a_great_drift_takes_keyframes_in_a_row_that_agree() {
        let drift = Pose2::new(1.0, 0.5, 0.03);
        let (right, wrong) = (|way| sighting(way, drift), |way| sighting(way, Pose2::new(-0.7, 0.0, 0.0)));
        assert_eq!(judge([right(0.0), right(0.4), right(0.8)]), [false, false, true]);
        assert_eq!(judge([right(0.0), wrong(0.4), right(0.8), right(1.2), right(1.6)]), [false, false, false, false, true]);
        let unclear = Sighting { condition_number: 80.0, ..right(0.4) };
        assert_eq!(judge([right(0.0), unclear, right(0.8), right(1.2)]), [false; 4]);
    }
}
