//! Data association: how correspondences between a sensed scan and the reference are found, the first step of an ICP iteration.

use std::sync::Arc;

use super::first_guess::FirstGuess;
use super::ray_order::RayOrder;
use super::solver::QuadraticForm;
use super::uncertainty::Uncertainty;
use super::view::View;
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;

/// A view with the pose of its laser in the reference frame.
#[derive(Clone, Debug)]
pub struct PlacedView {
    /// Pose of the view's laser in the reference frame.
    pub reference_from_view: Pose2,
    /// The view.
    pub view: Arc<View>,
}

impl PlacedView {
    /// The first or only view: its frame is the reference frame.
    pub fn at_origin(view: Arc<View>) -> Self {
        Self { reference_from_view: Pose2::IDENTITY, view }
    }
}

/// The correspondences found at one pose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Correspondences {
    /// Sum of their weighted squared errors as a function of the pose.
    pub(super) form: QuadraticForm,
    /// Number of sensed points with a correspondence.
    pub(super) count: u32,
    /// Number of inliers among them.
    pub(super) inliers: u32,
    /// Mean absolute error of the inliers, m.
    pub(super) mean_residual: f64,
    /// Hash of the set of correspondences, to detect cycles; `None` if no cycles can occur.
    pub(super) fingerprint: Option<u64>,
    /// Whether the robust kernel has stopped shrinking. While it shrinks, a small step is no sign of convergence.
    pub(super) is_kernel_settled: bool,
}

/// Overlap of a sensed scan with the surfaces of the views.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Agreement {
    /// Rays that end on a surface of a view.
    pub(super) agreeing: u32,
    /// Rays that end in the direction of a surface that some view sees.
    pub(super) visible: u32,
}

impl Agreement {
    /// Fraction of the visible rays that agree.
    pub(super) fn fraction(self) -> f64 {
        f64::from(self.agreeing) / f64::from(self.visible.max(1))
    }
}

/// Finds the correspondences between the points of a sensed scan and the views of a reference.
pub(super) trait DataAssociation: Send {
    /// Prepares a scan to serve as a reference.
    fn view(&mut self, scan: Scan) -> View;

    /// From now on, estimates the range noise from the scans that it prepares.
    fn estimate_noise(&mut self) {}

    /// Sets the reference of the next matches: at least one view, the first of them at the origin.
    fn set_views(&mut self, views: &[PlacedView]);

    /// Starts a match.
    fn begin(&mut self, guess: &FirstGuess);

    /// Sets the sensed scan.
    fn set_sensed(&mut self, scan: &Scan);

    /// Selects the rays to use from now on, and the maximum number of views, the first ones.
    fn select_rays(&mut self, order: RayOrder, max_views: usize);

    /// Number of selected rays.
    fn ray_count(&self) -> usize;

    /// Finds the correspondences of the selected rays at `pose`; `None` without a reference.
    fn find_correspondences(&mut self, pose: &Pose2) -> Option<Correspondences>;

    /// Uncertainty of `pose` from the last correspondences.
    fn uncertainty(&mut self, pose: &Pose2) -> Uncertainty;

    /// Agreement of the scans at the last pose; `None` if it would not tell a correct pose from a wrong one.
    fn agreement(&self) -> Option<Agreement> {
        None
    }

    /// Variance of the robust kernel for the next iteration, for [`Self::set_kernel_variance`].
    fn kernel_variance(&self) -> f64 {
        0.0
    }

    /// Sets the variance of the robust kernel.
    fn set_kernel_variance(&mut self, _variance: f64) {}

    /// Approximate number of rays that would agree at a pose.
    fn score(&self, _pose: &Pose2) -> u32 {
        0
    }

    /// The last correspondences as pairs (sensed point moved to `pose`, reference point), m, in the reference frame.
    fn matched_points(&self, pose: &Pose2, points: &mut Vec<(Point, Point)>);
}
