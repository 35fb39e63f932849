//! Proportional control on lateral and heading error, about the curvature of the path.

use super::View;

/// For small errors the car's deviation `e` along its way `s` obeys `e'' + (2 / l) e' + e / l^2 = 0`, critically damped: it dies out over
/// the length `l`, here half the look-ahead, as in pure pursuit, whose linear form is the same with less damping.
pub(super) fn curvature(view: &View) -> f64 {
    let length = 0.5 * view.lookahead;
    let heading = view.place.heading_error.sin();
    let lateral = (view.place.lateral_error / length).clamp(-1.0, 1.0);
    view.path.curvature(view.place.along) - (2.0 * heading + lateral) / length
}
