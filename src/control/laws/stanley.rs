//! The Stanley controller (Hoffmann et al., 2007).

use super::LawInput;
use crate::geometry::Pose2;

/// Minimum speed in the lateral error term, m/s: limits the gain at low speed.
const MIN_SPEED: f64 = 1.0;
/// Gain k of the lateral error, 1/s.
const GAIN: f64 = 2.5;

/// The front wheels point along the path, plus `atan(k e / v)` towards it: the lateral error `e` of the front axle decays as
/// `exp(-k t)`.
pub(super) fn curvature(input: &LawInput) -> f64 {
    let front = input.pose * Pose2::new(input.wheelbase, 0.0, 0.0);
    let along = input.projection.along;
    let projection =
        input.path.project(&front, along, along + 2.0 * input.wheelbase + input.lookahead).unwrap_or(input.projection);
    // The heading error is that at the front axle, so that the wheels point along the path there.
    let steering = -projection.heading_error - (GAIN * projection.lateral_error / input.speed.abs().max(MIN_SPEED)).atan();
    steering.clamp(-1.4, 1.4).tan() / input.wheelbase
}
