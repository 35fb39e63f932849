//! Closed-form minimum of the point-to-point error (Lu and Milios 1997).

use super::QuadraticForm;
use crate::geometry::Pose2;

/// With C = w I, the matrices A and S of the point-to-line solver are multiples of the identity. The stationarity condition then
/// makes the unit vector u of the heading point opposite to h.
pub(super) fn solve(form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
    let ([a, b, _], [g1, g2]) = form.blocks();
    let weight = a.m11;
    if weight <= 0.0 {
        return None;
    }
    let h = g2 - b.transpose() * g1 / weight;
    let (sin, cos) = prior.theta.sin_cos();
    let u = (-h).try_normalize(0.0).unwrap_or_else(|| [cos, sin].into());
    let t = -(g1 + b * u) / weight;
    Some(Pose2::new(t.x, t.y, u.y.atan2(u.x)))
}
