//! Collects scan points along the path, for the background of a plot.

use crate::app::sensed::SensorMessage;
use crate::app::{App, Estimate};
use crate::geometry::Point;

/// Maximum number of points: more make a plot larger, but not better.
const MAX_POINTS: usize = 20_000;
/// Maximum number of points of one scan.
const POINTS_PER_SCAN: usize = 60;

/// Collects points of keyframes. When there are too many, drops every second point, and from then on uses half as many keyframes.
#[derive(Debug, Default)]
pub struct MapSketch {
    points: Vec<Point>,
    keyframes: usize,
    /// Every how many keyframes one is used; 0 at the start means 1.
    keyframe_stride: usize,
}

impl MapSketch {
    /// Adds a processed scan.
    pub fn add(&mut self, message: &SensorMessage, estimate: &Estimate, app: &mut App) {
        if !estimate.registration.new_keyframe || !estimate.registration.outcome.is_ok() {
            return;
        }
        self.keyframes += 1;
        let Some(scan) = app.scan(message) else { return };
        if !self.keyframes.is_multiple_of(self.keyframe_stride.max(1)) {
            return;
        }
        let transform = (estimate.registration.map_from_base() * app.mount().0.base_from_laser).transform();
        let stride = scan.valid_len().div_ceil(POINTS_PER_SCAN).max(1);
        self.points.extend(scan.rays().step_by(stride).map(|(_, direction, range)| transform.apply(direction * range)));
        if self.points.len() > MAX_POINTS {
            let mut keep = false;
            self.points.retain(|_| {
                keep = !keep;
                keep
            });
            self.keyframe_stride = 2 * self.keyframe_stride.max(1);
        }
    }

    /// The points, m, in the map frame.
    pub fn points(&self) -> &[Point] {
        &self.points
    }
}
