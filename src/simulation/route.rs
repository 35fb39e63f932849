//! The closed route that a simulated car follows.

use crate::geometry::Point;

use super::world::World;

/// Distance between the points of a route, m.
const SPACING: f64 = 0.1;
/// Passes of the smoothing: with [`SPACING`] they round corners over about 1.5 m.
const SMOOTHING_PASSES: usize = 400;
/// Curvature is taken over this many points to either side.
const CURVATURE_SPAN: usize = 3;

/// A closed route: evenly spaced points, the last one followed by the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    points: Vec<Point>,
    spacing: f64,
}

impl Route {
    /// The route through `waypoints` and back to the first, with its corners rounded as far as `margin` from the walls allows.
    /// `None` if the waypoints are too close together to make a loop.
    pub fn smooth(waypoints: &[Point], world: &dyn World, margin: f64) -> Option<Self> {
        let mut points = evenly_spaced(waypoints)?;
        let clear = |new: Point, old: Point| {
            let room = world.clearance(new);
            room >= margin || room >= world.clearance(old)
        };
        for _ in 0..SMOOTHING_PASSES {
            for i in 0..points.len() {
                let [before, here, after] = around(&points, i, 1);
                let relaxed = 0.5 * here + 0.25 * (before + after);
                if clear(relaxed, here) {
                    points[i] = relaxed;
                }
            }
        }
        let points = evenly_spaced(&points)?;
        let spacing = length(&points) / points.len() as f64;
        Some(Self { points, spacing })
    }

    /// The same loop, run the other way round.
    #[must_use]
    pub fn reversed(mut self) -> Self {
        self.points.reverse();
        self
    }

    /// The same loop, begun at its point `index` (counted on round the loop).
    #[must_use]
    pub fn begun_at(mut self, index: usize) -> Self {
        let first = index % self.points.len();
        self.points.rotate_left(first);
        self
    }

    /// The points, at least three.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Distance from each point to the next, m.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Length of one lap, m.
    pub fn length(&self) -> f64 {
        self.spacing * self.points.len() as f64
    }

    /// The point `index`, counted on round the loop.
    pub fn point(&self, index: usize) -> Point {
        self.points[index % self.points.len()]
    }

    /// Curvature at point `index`, 1/m, positive to the left.
    pub fn curvature(&self, index: usize) -> f64 {
        let [before, here, after] = around(&self.points, index, CURVATURE_SPAN);
        let (arriving, leaving) = (here - before, after - here);
        arriving.perp(&leaving).atan2(arriving.dot(&leaving)) / (CURVATURE_SPAN as f64 * self.spacing)
    }
}

/// The points `span` before, at and `span` after `i` of a closed line.
fn around(points: &[Point], i: usize, span: usize) -> [Point; 3] {
    let n = points.len();
    [points[(i + n - span % n) % n], points[i % n], points[(i + span) % n]]
}

fn length(points: &[Point]) -> f64 {
    (0..points.len()).map(|i| (points[(i + 1) % points.len()] - points[i]).norm()).sum()
}

/// Points on the closed line through `corners`, about [`SPACING`] apart and evenly so along the line.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // the length is finite and positive
fn evenly_spaced(corners: &[Point]) -> Option<Vec<Point>> {
    let total = length(corners);
    let count = (total / SPACING).round() as usize;
    if count < 3 {
        return None;
    }
    let mut points = Vec::with_capacity(count);
    let mut passed = 0.0;
    for (i, &from) in corners.iter().enumerate() {
        let to = corners[(i + 1) % corners.len()];
        let edge = (to - from).norm();
        while points.len() < count {
            let ahead = points.len() as f64 * total / count as f64 - passed;
            if ahead >= edge {
                break;
            }
            points.push(from + (to - from) * (ahead / edge));
        }
        passed += edge;
    }
    Some(points)
}
