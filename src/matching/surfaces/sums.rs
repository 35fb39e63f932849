//! Sums over correspondences.

use std::ops::AddAssign;

use crate::geometry::Pose2;
use crate::matching::solver::QuadraticForm;

/// The quantities summed over the correspondences with a view, as indices into [`Sums`]. `w` is the weight, `a` the derivative of
/// the error `e` by the pose, `v` the variance.
#[derive(Clone, Copy, Debug)]
pub(super) enum Sum {
    /// `w a a'`: upper triangle, row by row, ten values.
    Matrix = 0,
    /// `w a e`, four values.
    Gradient = 10,
    /// `w e^2`, m^2.
    Squares = 14,
    /// `w v`: the expected value of `w e^2` if the range noise were 1 m.
    Expected,
    /// `w` times the variance of the direction of the surface: the information that direction errors alone produce.
    SpuriousInformation,
    /// `w`.
    Weights,
    /// `w e^2 / v - w`: weighted excess of the squared errors over the variance, by which the kernel variance is too low.
    Excess,
    /// Sum of the weights of [`Self::Excess`].
    ExcessWeights,
    /// Sum of the absolute errors of the inliers, m.
    Residuals,
    /// Number of inliers.
    Inliers,
    /// Number of correspondences.
    Correspondences,
    /// Number of sums.
    Count,
}

/// The sums, indexed by [`Sum`]. Matrix and gradient are in the frame of one view: added over several views, they are
/// meaningless.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums(pub(super) [f64; Sum::Count as usize]);

impl Sums {
    pub(super) fn of(&self, sum: Sum) -> f64 {
        self.0[sum as usize]
    }

    /// The weighted squared errors as a function of the pose in the frame of the view.
    pub(super) fn form(&self, view_from_sensed: &Pose2) -> QuadraticForm {
        let matrix = std::array::from_fn(|i| self.0[Sum::Matrix as usize + i]);
        let gradient = std::array::from_fn(|i| self.0[Sum::Gradient as usize + i]);
        QuadraticForm::from_sums(view_from_sensed, &matrix, &gradient, self.of(Sum::Squares))
    }
}

impl AddAssign<&Self> for Sums {
    fn add_assign(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, term)| *sum += term);
    }
}
