//! One Gauss-Newton step: linear least squares for a small change of heading.

use nalgebra::Matrix3;

use super::QuadraticForm;
use crate::geometry::Pose2;

/// Regularization that keeps the pose fixed along unconstrained directions, relative to the trace of the Hessian. It is far below
/// the weight of any measurement.
const REGULARIZATION: f64 = 1e-12;

pub(super) fn solve(form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
    let (gradient, hessian) = form.linearize(prior);
    let regularized = hessian + Matrix3::identity() * (REGULARIZATION * hessian.trace());
    let step = regularized.cholesky()?.solve(&-gradient);
    Some(Pose2::new(prior.x + step.x, prior.y + step.y, prior.theta + step.z))
}
