//! Scan points along the path, as the background of a plot.

use crate::app::sensed::Sensed;
use crate::app::{App, Estimate};
use crate::geometry::Point;

/// More points than this make a plot heavy, not better.
const MAX_POINTS: usize = 20_000;
/// Points of one scan.
const POINTS_PER_SCAN: usize = 60;

/// Collects points of keyframes; thins out as it fills up.
#[derive(Debug, Default)]
pub struct MapSketch {
    points: Vec<Point>,
    keyframes: usize,
    every: usize,
}

impl MapSketch {
    /// Takes a scan that has been answered.
    pub fn add(&mut self, message: &Sensed, estimate: &Estimate, app: &mut App) {
        if !estimate.registration.new_keyframe || !estimate.registration.outcome.is_ok() {
            return;
        }
        self.keyframes += 1;
        let Some(scan) = app.scan(message) else { return };
        if !self.keyframes.is_multiple_of(self.every.max(1)) {
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
            self.every = 2 * self.every.max(1);
        }
    }

    /// The points, m, in the map frame.
    pub fn points(&self) -> &[Point] {
        &self.points
    }
}
