//! Scan matching by iterative closest point (ICP): aligns a sensed scan with a reference scan.
//!
//! `Refinement::iterate` is one ICP iteration: find correspondences, reject outliers, solve for the pose. [`Refinement::refine`]
//! adds the coarse-to-fine levels, from few rays to all of them, and a multi-start search for when the scans do not agree.
//!
//! [`Matcher::begin`] starts a match, each call of `refine` improves it, and [`Refinement::pose`] is the best pose so far at any
//! time: this makes it an anytime algorithm. This module reads no clock, prints nothing and does not panic. It allocates nothing
//! once its buffers have grown to the size of the scans.

pub mod classic;
mod data_association;
mod first_guess;
mod ray_order;
mod refinement;
mod search;
pub mod solver;
mod stop_reason;
mod surface;
mod surfaces;
mod symmetric_eigen;
mod uncertainty;
mod view;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use crate::geometry::Pose2;
use crate::scan::Scan;
use classic::ClosestPoint;
use classic::correspondence::CorrespondenceKind;
use classic::rejection::RejectionKnobs;
use data_association::DataAssociation;
pub use data_association::PlacedView;
pub use first_guess::{FirstGuess, Prior, SearchWindow};
pub(crate) use refinement::COARSE_VIEWS;
pub use refinement::{IterationTrace, Refinement};
use search::MultiStartSearch;
use solver::{QuadraticForm, SolverKind};
pub use stop_reason::StopReason;
use surfaces::Projective;
pub use uncertainty::Uncertainty;
pub use view::View;

/// Maximum number of refinements per match: one from the first guess, and one from the result of the search.
const MAX_STAGES: usize = 2;

crate::knobs! {
    /// How two scans are matched.
    pub struct MatchingKnobs {
        /// How the correspondence of a point is found in the reference. `projective` pairs it with the surface seen in its
        /// direction, all others with its nearest point (classic PL-ICP).
        correspondence: CorrespondenceKind = CorrespondenceKind::Projective;
        /// Error metric and how it is minimised. Projective correspondences are point-to-line: `point_to_point` means
        /// `point_to_line` for them.
        solver: SolverKind = SolverKind::PointToLine;
        /// Maximum number of rays used of the sensed scan, spread over the whole field of view; 0: all.
        max_rays: u32 = 0, in 0 to 10000;
        /// Number of rays on the coarsest level, which does most of the alignment cheaply. Each following level uses four times
        /// as many; 0: all rays from the start.
        coarse_rays: u32 = 128, in 0 to 10000;
        /// Maximum number of iterations per match.
        max_iterations: u32 = 30, in 1 to 1000;
        /// Maximum distance between corresponding points.
        max_correspondence_distance: f64 = 0.5, in 0.001 to 100, unit "m";
        /// A match has converged when a step moves the pose by less than this and rotates it by less than `epsilon_rotation`.
        epsilon_translation: f64 = 3e-4, in 0 to 1, unit "m";
        /// See `epsilon_translation`.
        epsilon_rotation: f64 = 1e-4, in 0 to 1, unit "rad";
        /// Minimum fraction of the sensed rays that must have a correspondence.
        min_correspondence_ratio: f64 = 0.2, in 0 to 1;
        /// Standard deviation of a measured range. If keyframes with many rays show a larger one, that is used instead.
        range_noise: f64 = 0.01, in 0.0001 to 1, unit "m";
    }
}

/// Matches scans, and keeps its buffers from match to match.
pub struct Matcher {
    knobs: MatchingKnobs,
    association: Box<dyn DataAssociation>,
    solver: fn(&QuadraticForm, &Pose2) -> Option<Pose2>,
    search: MultiStartSearch,
    trace: Vec<IterationTrace>,
}

impl Matcher {
    /// Creates a matcher with these parameters.
    pub fn new(knobs: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        let solver = if knobs.correspondence.supports(knobs.solver) { knobs.solver } else { SolverKind::PointToLine };
        let association: Box<dyn DataAssociation> = match knobs.correspondence.search() {
            Some(search) => Box::new(ClosestPoint::new(search, rejection, knobs, solver.metric())),
            None => Box::new(Projective::new(knobs.range_noise)),
        };
        let mut matcher = Self {
            association,
            solver: solver.function(),
            search: MultiStartSearch::default(),
            trace: Vec::new(),
            knobs: knobs.clone(),
        };
        matcher.set_max_iterations(knobs.max_iterations);
        matcher
    }

    /// Changes the maximum number of iterations per match.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.knobs.max_iterations = limit;
        self.trace = Vec::with_capacity(MAX_STAGES * limit as usize); // so that no match allocates
    }

    /// Enables estimation of the range noise from the scans that this matcher prepares. If walls are uneven, a single match then
    /// claims less precision than it has. Along a path, however, errors that neighbouring rays share are not counted as
    /// information again and again.
    #[must_use]
    pub fn with_noise_estimation(mut self) -> Self {
        self.association.estimate_noise();
        self
    }

    /// Prepares a scan to serve as a reference.
    pub fn view(&mut self, scan: Scan) -> Arc<View> {
        Arc::new(self.association.view(scan))
    }

    /// Sets a single scan as the reference of the next matches.
    pub fn set_reference(&mut self, scan: &Scan) {
        let view = self.view(scan.clone());
        self.set_views(&[PlacedView::at_origin(view)]);
    }

    /// Sets the views that form the reference of the next matches. The frame of the first view is the reference frame.
    pub fn set_views(&mut self, views: &[PlacedView]) {
        self.association.set_views(views);
    }

    /// Starts to match a scan. `first_guess`: pose of the sensed laser in the reference frame.
    pub fn begin<'a>(&'a mut self, sensed: &'a Scan, first_guess: impl Into<FirstGuess>) -> Refinement<'a> {
        let first_guess = first_guess.into();
        self.trace.clear();
        self.association.begin(&first_guess);
        self.association.set_sensed(sensed);
        Refinement::new(self, sensed, first_guess)
    }
}
