//! One step of linear least squares: the heading's change taken as small.

use nalgebra::Matrix3;

use super::QuadraticForm;
use crate::geometry::Pose2;

/// Holds directions that the pairs leave open where they are; far below what any measurement weighs.
const REGULARIZATION: f64 = 1e-12;

pub(super) fn solve(form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
    let (gradient, hessian) = form.linearize(prior);
    let regularized = hessian + Matrix3::identity() * (REGULARIZATION * hessian.trace());
    let step = regularized.cholesky()?.solve(&-gradient);
    Some(Pose2::new(prior.x + step.x, prior.y + step.y, prior.theta + step.z))
}
