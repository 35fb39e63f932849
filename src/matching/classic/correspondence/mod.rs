//! Which reference ray is nearest to each sensed point.
//!
//! To add a search: a file with a type that implements [`CorrespondenceSearch`], a variant in [`Correspondence`] and a line in
//! [`Correspondence::search`]. The tests compare every search listed there with the brute force, `naive`.

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
    /// Index of the ray; without a match, where the search may start the next time.
    pub ray: u32,
    /// Squared distance between the points, m^2; infinite when none is near enough.
    pub squared_distance: f64,
}

impl Nearest {
    /// Nothing found and nothing known.
    pub const NONE: Self = Self { ray: NO_RAY, squared_distance: f64::INFINITY };

    /// Whether there is a match.
    pub fn found(&self) -> bool {
        self.squared_distance.is_finite()
    }
}

/// A way to find, for many points at once, the nearest measured ray of the reference scan.
pub trait CorrespondenceSearch: Send {
    /// Prepares for a new reference scan.
    fn prepare(&mut self, reference: &Reference);

    /// For each of `points` (in the reference frame) the nearest ray closer than `max_distance` m. `nearest` comes with the
    /// answers of the last call, for the same points some steps of the pose ago (or [`Nearest::NONE`]), and leaves with the new
    /// ones: a search may start at them, its answer must not depend on them.
    fn find(&self, reference: &Reference, points: &[Point], max_distance: f64, nearest: &mut [Nearest]);
}

crate::choices! {
    /// The correspondence searches there are.
    pub enum Correspondence {
        /// Brute force over all rays.
        Naive = "naive",
        /// Jump tables (Censi 2008): exact, and few rays looked at.
        JumpTable = "jump_table",
        /// A k-d tree.
        #[cfg(feature = "cli")]
        KdTree = "kd_tree",
        /// Not the nearest ray, but the surface that the reference laser saw in the point's direction.
        Projective = "projective",
    }
}

impl Correspondence {
    /// Whether pairs of this kind are what a solver solves for: projective ones have no points but those on the lines.
    pub fn serves(self, solver: SolverKind) -> bool {
        self != Self::Projective || solver != SolverKind::PointToPoint
    }

    /// A search of this kind, where it is one for the nearest ray.
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
