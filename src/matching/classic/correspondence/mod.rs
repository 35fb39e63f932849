//! Nearest-point correspondence search: finds the reference ray nearest to each sensed point.
//!
//! To add a search, write a file with a type that implements [`CorrespondenceSearch`], and add a variant to
//! [`CorrespondenceKind`] and a line to [`CorrespondenceKind::search`]. The tests compare every search listed there with brute
//! force, `naive`.

mod jump_table;
#[cfg(feature = "cli")]
mod kd_tree;
mod naive;

use crate::geometry::Point;
use crate::matching::classic::reference::{NO_RAY, Reference};
use crate::matching::solver::SolverKind;

/// The nearest reference ray of one sensed point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Index of the ray. Without a match: where the next search may start.
    pub ray: u32,
    /// Squared distance between the points, m^2; infinite if no ray is near enough.
    pub squared_distance: f64,
}

impl Nearest {
    /// No match, and no hint where to start.
    pub const NONE: Self = Self { ray: NO_RAY, squared_distance: f64::INFINITY };

    /// Whether there is a match.
    pub fn is_match(&self) -> bool {
        self.squared_distance.is_finite()
    }
}

/// Finds, for many points at once, the nearest measured ray of the reference scan.
pub trait CorrespondenceSearch: Send {
    /// Prepares for a new reference scan.
    fn prepare(&mut self, reference: &Reference);

    /// For each of `points` (in the reference frame), finds the nearest ray closer than `max_distance` m. On entry, `nearest`
    /// holds the results of the previous call for the same points at a slightly different pose (or [`Nearest::NONE`]); on return,
    /// the new results. A search may start at the previous results, but its results must not depend on them.
    fn find(&self, reference: &Reference, points: &[Point], max_distance: f64, nearest: &mut [Nearest]);
}

crate::choices! {
    /// How correspondences are found.
    pub enum CorrespondenceKind {
        /// Brute force over all rays.
        Naive = "naive",
        /// Jump tables (Censi 2008): exact, and visits few rays.
        JumpTable = "jump_table",
        /// A k-d tree.
        #[cfg(feature = "cli")]
        KdTree = "kd_tree",
        /// Not the nearest ray but the surface that the reference laser saw in the direction of the point.
        Projective = "projective",
    }
}

impl CorrespondenceKind {
    /// Whether a solver can use these correspondences: projective ones have no reference points, only lines.
    pub fn supports(self, solver: SolverKind) -> bool {
        self != Self::Projective || solver != SolverKind::PointToPoint
    }

    /// The search of this kind; `None` for `Projective`, which does not search for the nearest ray.
    pub fn search(self) -> Option<Box<dyn CorrespondenceSearch>> {
        match self {
            Self::Naive => Some(Box::new(naive::Naive)),
            Self::JumpTable => Some(Box::<jump_table::JumpTable>::default()),
            #[cfg(feature = "cli")]
            Self::KdTree => Some(Box::<kd_tree::KdTreeSearch>::default()),
            Self::Projective => None,
        }
    }
}
