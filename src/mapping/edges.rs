//! Matches of pairs of keyframes as edges of the graph.
//!
//! Each match compares one keyframe with one other, without a prior. The edges of the graph are then independent, and their covariances
//! honest. A match against several keyframes at once would be more precise, but the errors of those keyframes are correlated and
//! missing from its covariance.

use std::sync::Arc;

use nalgebra::Matrix3;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::classic::rejection::RejectionKnobs;
use crate::matching::{FirstGuess, Matcher, MatchingKnobs, PlacedView, SearchWindow, View};
use crate::odometry::uncertainty;
use crate::scan::Scan;

/// Minimum position error of a match, m, however many pairs it has: walls are uneven, beams are wide, and errors that neighbouring rays
/// share do not average out.
const MIN_ERROR: f64 = 0.005;
/// Minimum rotation error of a match, rad.
const MIN_ROTATION_ERROR: f64 = 0.001;
/// Two keyframes nearer to each other than this, m, overlap only if both lasers face the same direction.
const VIEW_CHECK_DISTANCE: f64 = 2.0;
/// Minimum fraction of the rays that must end within the other keyframe's view, for keyframes of different visits.
const MIN_OVERLAP: f64 = 0.4;
/// Error assumed along a direction that the pairs leave unconstrained, m (and rad): much larger than any real one.
const UNCONSTRAINED_ERROR: f64 = 100.0;

/// Result of matching two keyframes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    /// Pose of the later laser in the frame of the earlier one.
    pub(super) motion: Pose2,
    /// Covariance of the motion along the axes of the earlier laser; large along unconstrained directions.
    pub(super) covariance: PoseCovariance,
    /// Of the rays that end within the other keyframe's view, the fraction that end on one of its surfaces.
    pub(super) agreement: f64,
    /// Fraction of the rays that end within the other keyframe's view.
    overlap: f64,
    /// Condition number of the pairs' information matrix.
    pub(super) condition_number: f64,
}

/// Matches pairs of keyframes.
pub(super) struct EdgeMatcher {
    matcher: Matcher,
}

impl EdgeMatcher {
    pub(super) fn new(matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self { matcher: Matcher::new(matching, rejection).with_noise_estimation() }
    }

    /// Prepares a scan for matching, and learns the range noise from it.
    pub(super) fn view(&mut self, scan: Scan) -> Arc<View> {
        self.matcher.view(scan)
    }

    /// Matches keyframes of two visits, searching in a window around the guess; `None` if that fails or they overlap too little.
    pub(super) fn compare_visits(
        &mut self,
        earlier: &Arc<View>,
        later: &View,
        guess: Pose2,
        window: SearchWindow,
    ) -> Option<Match> {
        let matched = self.compare(earlier, later, FirstGuess { window, ..guess.into() });
        matched.filter(|matched| matched.overlap >= MIN_OVERLAP)
    }

    /// Pose of `later` in the frame of `earlier`; `None` if the match fails.
    pub(super) fn compare(&mut self, earlier: &Arc<View>, later: &View, guess: impl Into<FirstGuess>) -> Option<Match> {
        let guess = guess.into();
        if guess.pose.distance() < VIEW_CHECK_DISTANCE && !earlier.scan().shares_view_with(later.scan(), guess.pose.theta) {
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
        let uncertainty = refinement.uncertainty()?;
        let last = refinement.trace().last()?;
        Some(Match {
            motion: refinement.pose(),
            covariance: covariance(uncertainty.information?)?,
            agreement: refinement.agreement().unwrap_or(1.0),
            overlap: f64::from(last.correspondences) / f64::from(last.rays.max(1)),
            condition_number: uncertainty.condition_number,
        })
    }
}

/// Covariance of an edge from the information matrix of its pairs. Unconstrained directions get [`UNCONSTRAINED_ERROR`].
fn covariance(mut information: Matrix3<f64>) -> Option<PoseCovariance> {
    information += Matrix3::identity() / (UNCONSTRAINED_ERROR * UNCONSTRAINED_ERROR);
    let covariance = information.try_inverse()? + min_covariance();
    covariance.iter().all(|value| value.is_finite()).then_some(covariance)
}

/// Minimum covariance of a motion between keyframes.
pub(super) fn min_covariance() -> PoseCovariance {
    uncertainty::diagonal(MIN_ERROR, MIN_ROTATION_ERROR)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// A corridor with walls 2 m to either side, closed by a wall at `end` if given.
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
    fn a_corridor_is_unconstrained_along_its_axis_only() {
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
        assert!(closed.covariance.m11 < 0.01_f64.powi(2) && closed.covariance.m11 >= MIN_ERROR.powi(2));
        assert!(closed.motion.between(&later).distance() < 0.005 && closed.agreement > 0.9 && closed.overlap > 0.8);
    }
}
