//! Pure pursuit (Coulter, 1992).

use super::View;

/// The target is looked for along the path in steps of this part of the look-ahead.
const STEPS: f64 = 20.0;

/// The circle through the car, tangent to its heading, that meets the path one look-ahead away. The look-ahead is sqrt 2 times the
/// lateral error at least, so that the car meets the path at 45 degrees or less; beyond the end of the path its last direction goes on.
pub(super) fn curvature(view: &View) -> f64 {
    let lookahead = view.lookahead.max(std::f64::consts::SQRT_2 * view.place.lateral_error.abs());
    let seen = |along: f64| view.pose.inverse().transform().apply(view.path.point(along));
    let mut along = view.place.along;
    let step = lookahead / STEPS;
    // No point of the path is farther away than it is along it: the way is at least the distance.
    while along < view.place.along + 4.0 * lookahead && seen(along).norm() < lookahead {
        along += step;
    }
    let target = seen(along);
    2.0 * target.y / target.norm_squared()
}
