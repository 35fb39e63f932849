//! Matches of pairs of keyframes as edges of the graph.
//!
//! One keyframe against one other, without a prior: then the edges of a graph are independent, and their covariances honest. A match to several
//! keyframes at once would be more precise, but those err alike, and their own errors are not in its covariance.

use std::sync::Arc;

use nalgebra::Matrix3;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::classic::rejection::RejectionKnobs;
use crate::matching::{FirstGuess, Matcher, MatchingKnobs, PlacedView, View};
use crate::odometry::uncertainty;
use crate::scan::Scan;

/// What no match is better than, whatever its pairs know: walls are uneven and beams wide, and what neighbouring rays err in common stays. m ...
const LEAST_ERROR: f64 = 0.005;
/// ... and rad.
const LEAST_TURN_ERROR: f64 = 0.001;
/// Of two keyframes that are nearer to one another, m, both see the same only where both look in the same direction.
const NEAR: f64 = 2.0;
/// Along a direction that pairs leave open so much is unknown, m (and rad): more than anything that is known.
const OPEN: f64 = 100.0;

/// What a match of two keyframes says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    /// Pose of the later laser seen from the earlier one.
    pub(super) motion: Pose2,
    /// Along the axes of the earlier one; wide along what the pairs leave open.
    pub(super) covariance: PoseCovariance,
    /// Part of the rays that end where the other keyframe sees, that end where it has a surface.
    pub(super) agreement: f64,
    /// Part of the rays that end where the other one sees.
    pub(super) overlap: f64,
    /// Of the pairs' information.
    pub(super) condition_number: f64,
}

/// Matches keyframes.
pub(super) struct EdgeMatcher {
    matcher: Matcher,
}

impl EdgeMatcher {
    pub(super) fn new(matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self { matcher: Matcher::new(matching, rejection).learning_noise() }
    }

    /// Prepares a scan; its noise is learned from.
    pub(super) fn view(&mut self, scan: Scan) -> Arc<View> {
        self.matcher.view(scan)
    }

    /// Where `later` was seen from `earlier`; `None` where nothing fits.
    pub(super) fn compare(&mut self, earlier: &Arc<View>, later: &View, guess: impl Into<FirstGuess>) -> Option<Match> {
        let guess = guess.into();
        if guess.pose.distance() < NEAR && !earlier.scan().shares_view_with(later.scan(), guess.pose.theta) {
            return None;
        }
        self.matcher.set_views(&[PlacedView::at_origin(Arc::clone(earlier))]);
        let mut refinement = self.matcher.begin(later.scan(), guess);
        let stop_reason = loop {
            if let Some(reason) = refinement.refine() {
                break reason;
            }
        };
        if stop_reason.is_failure() {
            return None;
        }
        let known = refinement.uncertainty()?;
        let last = refinement.trace().last()?;
        Some(Match {
            motion: refinement.pose(),
            covariance: covariance(known.information?)?,
            agreement: refinement.agreement().unwrap_or(1.0),
            overlap: f64::from(last.correspondences) / f64::from(last.rays.max(1)),
            condition_number: known.condition_number,
        })
    }
}

/// The covariance that an edge has by what the pairs know; along a direction that they leave open that is nothing.
fn covariance(mut information: Matrix3<f64>) -> Option<PoseCovariance> {
    information += Matrix3::identity() / (OPEN * OPEN);
    let covariance = information.try_inverse()? + least();
    covariance.iter().all(|value| value.is_finite()).then_some(covariance)
}

/// Covariance that no motion between keyframes is known better than.
pub(super) fn least() -> PoseCovariance {
    uncertainty::diagonal(LEAST_ERROR, LEAST_TURN_ERROR)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// Two walls, 2 m to either side; with one across at `end` where there is any.
    fn corridor(end: Option<f64>, from: &Pose2) -> Scan {
        let beams = BeamGeometry::new(-3.1, 0.0174, 356);
        let range = |i: usize| {
            let direction = from.transform().rotate(beams.directions()[i]);
            let side = ((2.0 * direction.y.signum() - from.y) / direction.y).abs();
            end.map_or(side, |end| if direction.x > 0.0 { side.min((end - from.x) / direction.x) } else { side }).min(12.0)
        };
        let ranges: Vec<f64> = (0..beams.len()).map(range).collect();
        Scan::new(Stamp::default(), beams.clone().into(), (0.0, 11.9), ranges).unwrap()
    }

    #[test]
    fn along_a_corridor_nothing_is_known_and_across_it_all() {
        let mut matcher = EdgeMatcher::new(&MatchingKnobs::default(), &RejectionKnobs::default());
        let later = Pose2::new(0.3, 0.1, 0.05);
        let mut compare = |end: Option<f64>| {
            let (earlier, later) = (matcher.view(corridor(end, &Pose2::IDENTITY)), matcher.view(corridor(end, &later)));
            matcher.compare(&earlier, &later, Pose2::new(0.25, 0.0, 0.0)).unwrap()
        };
        let open = compare(None);
        assert!(open.covariance.m11 > 100.0 && open.covariance.m22 < 0.01_f64.powi(2) && open.covariance.m33 < 0.01_f64.powi(2));
        assert!((open.motion.y - 0.1).abs() < 0.005 && (open.motion.theta - 0.05).abs() < 0.005);
        let closed = compare(Some(6.0));
        assert!(closed.covariance.m11 < 0.01_f64.powi(2) && closed.covariance.m11 >= LEAST_ERROR.powi(2));
        assert!(closed.motion.between(&later).distance() < 0.005 && closed.agreement > 0.9 && closed.overlap > 0.8);
    }
}
