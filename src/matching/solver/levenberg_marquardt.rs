//! Nonlinear least squares by Levenberg-Marquardt, with the damping of Nielsen (1999).
//!
//! For three parameters on a quadratic form this takes few lines. The `levenberg-marquardt` crate works on residual vectors as
//! long as the scan, and allocates them.

use nalgebra::Matrix3;

use super::QuadraticForm;
use crate::geometry::Pose2;

/// Maximum number of steps.
const MAX_STEPS: usize = 50;
/// The solution has converged when a step lowers the cost by less than this fraction.
const COST_TOLERANCE: f64 = 1e-14;
/// The solution has converged when a step is shorter than this, in m and rad.
const STEP_TOLERANCE: f64 = 1e-12;

pub(super) fn solve(form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
    let mut pose = *prior;
    let mut cost = form.value(&pose);
    let mut damping = 1e-6;
    let mut growth = 2.0;
    for _ in 0..MAX_STEPS {
        let (gradient, hessian) = form.linearize(&pose);
        let scale = hessian.trace() / 3.0;
        let step = (hessian + Matrix3::identity() * (damping * scale)).cholesky()?.solve(&-gradient);
        let candidate = Pose2::new(pose.x + step.x, pose.y + step.y, pose.theta + step.z);
        let candidate_cost = form.value(&candidate);
        if candidate_cost <= cost {
            let decrease = cost - candidate_cost;
            (pose, cost) = (candidate, candidate_cost);
            if step.norm() <= STEP_TOLERANCE || decrease <= COST_TOLERANCE * cost {
                break;
            }
            damping *= 0.1;
            growth = 2.0;
        } else {
            if step.norm() <= STEP_TOLERANCE {
                break;
            }
            damping *= growth;
            growth *= 2.0;
        }
    }
    Some(pose)
}
