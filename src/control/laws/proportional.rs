//! Proportional control of lateral and heading error, with the curvature of the path as feedforward.

use super::LawInput;

/// For small errors the lateral error `e` obeys `e'' + (2 / l) e' + e / l^2 = 0` over the driven distance `s`. This is critically
/// damped: the error decays over the length `l`, here half the lookahead distance. Linearized pure pursuit is the same with less
/// damping.
pub(super) fn curvature(input: &LawInput) -> f64 {
    let length = 0.5 * input.lookahead;
    let heading = input.projection.heading_error.sin();
    let lateral = (input.projection.lateral_error / length).clamp(-1.0, 1.0);
    input.path.curvature(input.projection.along) - (2.0 * heading + lateral) / length
}
