//! The law of the car Stanley (Hoffmann et al., 2007).

use super::View;
use crate::geometry::Pose2;

/// Below this speed the lateral error counts as at this speed, m/s.
const SOFTENING: f64 = 1.0;
/// Lateral speed for each metre of error, 1/s.
const GAIN: f64 = 2.5;

/// The front wheels are turned along the path, and towards it by `atan(k e / v)`: the error of the front axle dies out as `exp(-k t)`.
pub(super) fn curvature(view: &View) -> f64 {
    let front = view.pose * Pose2::new(view.wheelbase, 0.0, 0.0);
    let along = view.place.along;
    let place = view.path.project(&front, along, along + 2.0 * view.wheelbase + view.lookahead).unwrap_or(view.place);
    // At the front axle the path has turned on already: the wheels point along it there.
    let steering = -place.heading_error - (GAIN * place.lateral_error / view.speed.abs().max(SOFTENING)).atan();
    steering.clamp(-1.4, 1.4).tan() / view.wheelbase
}
