//! Who pairs with whom: what one iteration of ICP makes of a pose before it solves for the next one.

use std::sync::Arc;

use super::ray_order::RayOrder;
use super::solver::{Metric, QuadraticForm};
use super::view::View;
use super::{FirstGuess, Uncertainty};
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;

/// A view, and where its laser was in the reference frame.
#[derive(Clone, Debug)]
pub struct PlacedView {
    /// Pose of the view's laser in the reference frame.
    pub reference_from_view: Pose2,
    /// What it saw.
    pub view: Arc<View>,
}

impl PlacedView {
    /// The only view, or the first one: its frame is the reference frame.
    pub fn at_origin(view: Arc<View>) -> Self {
        Self { reference_from_view: Pose2::IDENTITY, view }
    }
}

/// The pairs at one pose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pairs {
    /// Their weighed squared errors, as a function of the pose.
    pub(super) form: QuadraticForm,
    /// Sensed points with a partner.
    pub(super) correspondences: u32,
    /// Of those, the ones that count.
    pub(super) inliers: u32,
    /// Mean absolute error of the inliers, m.
    pub(super) mean_residual: f64,
    /// Identity of the set of pairs where steps can go round in a circle: equal when the pairs are.
    pub(super) fingerprint: Option<u64>,
    /// Whether the next pairs are weighed as these are: before, a small step is no sign of convergence.
    pub(super) settled: bool,
}

/// How far a sensed scan and the views agree.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Agreement {
    /// Rays that end where a view has a surface.
    pub(super) agreeing: u32,
    /// Rays that end where a view sees.
    pub(super) seen: u32,
}

impl Agreement {
    /// Part of the rays seen that agree.
    pub(super) fn share(self) -> f64 {
        f64::from(self.agreeing) / f64::from(self.seen.max(1))
    }
}

/// A way to pair the points of a sensed scan with the views of a reference.
pub(super) trait Pairing: Send {
    /// Prepares a scan to be matched to.
    fn view(&mut self, scan: Scan) -> View;

    /// Learns from now on, from the scans it prepares, how much ranges err.
    fn learn_noise(&mut self) {}

    /// Sets what the next scans are matched to: one view at least, the first of them at the origin.
    fn set_views(&mut self, views: &[PlacedView]);

    /// Begins a match.
    fn begin(&mut self, guess: &FirstGuess);

    /// Takes over the sensed scan.
    fn sense(&mut self, scan: &Scan);

    /// These of its rays take part from now on.
    fn choose_rays(&mut self, order: RayOrder);

    /// No more than so many of the views take part from now on, the first ones.
    fn choose_views(&mut self, _at_most: usize) {}

    /// Number of rays that take part.
    fn rays(&self) -> usize;

    /// Pairs the points as they are at `pose`; `None` without a reference.
    fn pair(&mut self, pose: &Pose2, metric: Metric) -> Option<Pairs>;

    /// How well the last pairs fix `pose`.
    fn uncertainty(&mut self, pose: &Pose2, metric: Metric) -> Uncertainty;

    /// How far the scans agreed at the last pose; `None` where that says nothing of whether it is the right one.
    fn agreement(&self) -> Option<Agreement> {
        None
    }

    /// How wide the kernel is that weighs the next pairs, in the pairing's own terms: for [`Self::set_width`].
    fn width(&self) -> f64 {
        0.0
    }

    /// Sets the kernel's width.
    fn set_width(&mut self, _width: f64) {}

    /// Rays that would agree at a pose, roughly.
    fn score(&self, _pose: &Pose2) -> u32 {
        0
    }

    /// The last pairs as (sensed point moved to `pose`, reference point), m, in the reference frame.
    fn matched_points(&self, pose: &Pose2, points: &mut Vec<(Point, Point)>);
}
