//! What is summed over pairs.

use std::ops::AddAssign;

use crate::geometry::Pose2;
use crate::matching::solver::QuadraticForm;

/// What is summed over the pairs with a view, by name of the place in [`Sums`].
#[derive(Clone, Copy, Debug)]
pub(super) enum Sum {
    /// `w a a'`: upper triangle, row by row, ten of them.
    Matrix = 0,
    /// `w a e`, four of them.
    Gradient = 10,
    /// `w e^2`, m^2.
    Squares = 14,
    /// `w v`: what `w e^2` would be were the noise 1 m.
    Expected,
    /// `w` by the variance of the surface's direction.
    Feigned,
    /// `w`.
    Weights,
    /// `w e^2 / v - w`, by how much the floor is too low, weighed.
    Excess,
    /// The weights of that.
    ExcessWeights,
    /// Absolute errors of the inliers, m.
    Residuals,
    /// Inliers.
    Inliers,
    /// Pairs.
    Pairs,
    /// Number of sums.
    Count,
}

/// Sums over pairs, by place. Matrix and gradient are those of one view, in its frame; of several together they mean nothing.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums(pub(super) [f64; Sum::Count as usize]);

impl Sums {
    pub(super) fn of(&self, sum: Sum) -> f64 {
        self.0[sum as usize]
    }

    /// The weighed squared errors as a function of the pose in the view's frame.
    pub(super) fn form(&self, view_from_sensed: &Pose2) -> QuadraticForm {
        let matrix = std::array::from_fn(|i| self.0[Sum::Matrix as usize + i]);
        let gradient = std::array::from_fn(|i| self.0[Sum::Gradient as usize + i]);
        QuadraticForm::about(view_from_sensed, &matrix, &gradient, self.of(Sum::Squares))
    }
}

impl AddAssign<&Self> for Sums {
    fn add_assign(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, term)| *sum += term);
    }
}
