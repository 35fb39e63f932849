//! The closed route that a simulated car follows.

use crate::geometry::Point;

use super::world::World;

/// Distance between the points of a route, m.
const SPACING: f64 = 0.1;
/// Smoothing passes: with [`SPACING`] they round corners over about 1.5 m.
const SMOOTHING_PASSES: usize = 400;
/// Number of points on either side that the curvature is computed from.
const CURVATURE_SPAN: usize = 3;

/// A closed route: evenly spaced points, the last one followed by the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    points: Vec<Point>,
    spacing: f64,
}

impl Route {
    /// The closed route through `waypoints`, with corners rounded as far as the distance `margin` from the walls allows. `None`
    /// if the waypoints are too close together for a loop.
    pub fn smooth(waypoints: &[Point], world: &dyn World, margin: f64) -> Option<Self> {
        let mut points = evenly_spaced(waypoints)?;
        let count = points.len();
        relax(&mut points, 0..count, world, margin);
        let points = evenly_spaced(&points)?;
        let spacing = length(&points) / points.len() as f64;
        Some(Self { points, spacing })
    }

    /// The same loop in the opposite direction.
    #[must_use]
    pub fn reversed(mut self) -> Self {
        self.points.reverse();
        self
    }

    /// The same loop, starting at point `index` (modulo the number of points).
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

    /// The point `index` (modulo the number of points).
    pub fn point(&self, index: usize) -> Point {
        self.points[index % self.points.len()]
    }

    /// Curvature at point `index`, 1/m, positive to the left.
    pub fn curvature(&self, index: usize) -> f64 {
        let [before, here, after] = neighbours(&self.points, index, CURVATURE_SPAN);
        let (arriving, leaving) = (here - before, after - here);
        arriving.perp(&leaving).atan2(arriving.dot(&leaving)) / (CURVATURE_SPAN as f64 * self.spacing)
    }
}

/// The open path through `corners`, with corners rounded as far as the distance `margin` from the walls allows; its ends stay
/// fixed.
pub fn smooth_path(corners: &[Point], world: &dyn World, margin: f64) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    for ends in corners.windows(2) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
        let steps = ((ends[1] - ends[0]).norm() / SPACING).ceil().max(1.0) as usize;
        points.extend((0..steps).map(|step| ends[0] + (ends[1] - ends[0]) * (step as f64 / steps as f64)));
    }
    points.extend(corners.last());
    let inner = 1..points.len().saturating_sub(1).max(1);
    relax(&mut points, inner, world, margin);
    points
}

/// Smooths the points in `range` of a closed line: moves each towards the middle of its neighbours, repeatedly, where the
/// clearance allows it.
fn relax(points: &mut [Point], range: std::ops::Range<usize>, world: &dyn World, margin: f64) {
    let is_clear = |new: Point, old: Point| {
        let clearance = world.clearance(new);
        clearance >= margin || clearance >= world.clearance(old)
    };
    for _ in 0..SMOOTHING_PASSES {
        for i in range.clone() {
            let [before, here, after] = neighbours(points, i, 1);
            let relaxed = 0.5 * here + 0.25 * (before + after);
            if is_clear(relaxed, here) {
                points[i] = relaxed;
            }
        }
    }
}

/// Points `i - span`, `i` and `i + span` of a closed line.
fn neighbours(points: &[Point], i: usize, span: usize) -> [Point; 3] {
    let n = points.len();
    [points[(i + n - span % n) % n], points[i % n], points[(i + span) % n]]
}

fn length(points: &[Point]) -> f64 {
    (0..points.len()).map(|i| (points[(i + 1) % points.len()] - points[i]).norm()).sum()
}

/// Evenly spaced points on the closed line through `corners`, about [`SPACING`] apart.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::shapes::Shapes;

    #[test]
    fn an_open_path_keeps_its_ends_and_rounds_its_corners() {
        let corners = [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0)].map(|(x, y)| Point::new(x, y));
        let path = smooth_path(&corners, &Shapes::default(), 0.4);
        assert_eq!((path[0], path[path.len() - 1]), (corners[0], corners[2]));
        assert!(
            path.iter().all(|point| (point - corners[1]).norm() > 0.2) && path.windows(2).all(|w| (w[1] - w[0]).norm() < 0.11)
        );
    }
}
