//! Pure pursuit (Coulter, 1992).

use super::LawInput;

/// Search steps along the path per lookahead distance.
const STEPS_PER_LOOKAHEAD: f64 = 20.0;

/// Curvature of the circle through the car, tangent to its heading, that meets the path at the lookahead distance. The lookahead
/// distance is at least sqrt 2 times the lateral error, so that the car meets the path at 45 degrees or less. Beyond its end the
/// path continues straight.
pub(super) fn curvature(input: &LawInput) -> f64 {
    let lookahead = input.lookahead.max(std::f64::consts::SQRT_2 * input.projection.lateral_error.abs());
    let point_in_base = |along: f64| input.pose.inverse().transform().apply(input.path.point(along));
    let mut along = input.projection.along;
    let step = lookahead / STEPS_PER_LOOKAHEAD;
    // The search is limited: a tightly wound path may nowhere be one lookahead distance away.
    while along < input.projection.along + 4.0 * lookahead && point_in_base(along).norm() < lookahead {
        along += step;
    }
    let target = point_in_base(along);
    2.0 * target.y / target.norm_squared()
}
