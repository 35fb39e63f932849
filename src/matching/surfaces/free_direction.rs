//! The direction in which the correspondences do not constrain the translation, as along a corridor.

use nalgebra::{Matrix2, Matrix3, Vector3};

use super::Projective;
use super::sums::Sum;
use crate::geometry::{Point, Pose2};
use crate::matching::solver::QuadraticForm;
use crate::matching::symmetric_eigen::SymmetricEigen;

/// A direction is unobservable if its information is less than this many times what errors of the surface directions alone
/// produce.
const MIN_INFORMATION_RATIO: f64 = 4.0;

impl Projective {
    /// The direction in which the correspondences do not constrain the translation, if there is one: a unit vector. Apparent
    /// information that errors of the surface directions could produce does not count: the errors of the line fits, plus
    /// `direction_error`, rad.
    pub(super) fn free_direction(&self, pose: &Pose2, direction_error: f64) -> Option<Point> {
        let information = 0.5 * self.form.linearize(pose).1;
        let coupling = information.fixed_view::<2, 1>(0, 2);
        let translation = information.fixed_view::<2, 2>(0, 0) - coupling * coupling.transpose() / information.m33;
        let eigen = SymmetricEigen::of(&Matrix2::from(translation));
        let spurious = (self.totals.of(Sum::SpuriousInformation)
            + direction_error * direction_error * self.totals.of(Sum::Weights))
            / self.views_per_ray();
        (eigen.values.x < MIN_INFORMATION_RATIO * spurious).then_some(eigen.minor)
    }

    /// A constraint that keeps the pose at the prior, or at the guess, along the unconstrained direction.
    pub(super) fn constrain_free_direction(&self, pose: &Pose2) -> QuadraticForm {
        // Here only the errors of the fits count: even little information is better than none.
        let Some(direction) = self.free_direction(pose, 0.0) else { return QuadraticForm::default() };
        let expected = self.guess.prior.map_or(self.guess.pose, |prior| prior.pose);
        let mut form = QuadraticForm::default();
        // A line through the expected position, perpendicular to the unconstrained direction, with the total weight of the
        // correspondences.
        form.add_line(Point::zeros(), direction, direction.dot(&expected.translation()), self.totals.of(Sum::Expected));
        form
    }
}

/// Removes all information along a direction of the translation. What single-precision rounding leaves there, a difference of
/// large numbers, may even be negative.
pub(super) fn remove_information(information: &Matrix3<f64>, direction: &Point) -> Matrix3<f64> {
    let unobservable = Vector3::new(direction.x, direction.y, 0.0);
    let rest = Matrix3::identity() - unobservable * unobservable.transpose();
    rest * information * rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_information_remains_along_a_removed_direction() {
        // A wall along the direction (0.6, 0.8), with slightly negative information along it.
        let (wall, unobservable) = (Vector3::new(0.8, -0.6, 3.0), Vector3::new(0.6, 0.8, 0.0));
        let information = 1e8 * wall * wall.transpose() - 25.0 * unobservable * unobservable.transpose();
        let left = remove_information(&information, &Point::new(0.6, 0.8));
        assert!((left * unobservable).norm() < 1e-6, "{left}");
        let total = left + Matrix3::identity() / 30.0;
        assert!(total.cholesky().is_some(), "{total}");
    }
}
