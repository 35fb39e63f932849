//! Worlds drawn from line segments and circles: exact ranges, in closed form.

use crate::geometry::{Point, RigidTransform, perpendicular};

use super::world::World;

/// A straight thin wall.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment {
    from: Point,
    to: Point,
}

/// A round wall.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Circle {
    centre: Point,
    radius: f64,
}

/// Rays that pass an end of a segment by this part of its length still meet it, so that none slips through a corner.
const OVERLAP: f64 = 1e-12;

impl Segment {
    /// Solves `origin + t direction = from + u (to - from)` for t, with u in 0..1.
    fn range(&self, origin: Point, direction: Point) -> Option<f64> {
        let along = self.to - self.from;
        let offset = self.from - origin;
        let determinant = direction.perp(&along);
        let (whole, part) = (determinant.abs(), offset.perp(&direction) * determinant.signum()); // u = part / whole
        // Most rays pass most segments by: that is told without a division.
        if part < -OVERLAP * whole || part > (1.0 + OVERLAP) * whole {
            return None;
        }
        let t = offset.perp(&along) / determinant;
        // A ray parallel to the segment has determinant 0, hence t infinite or NaN: a thin wall cannot be seen edge-on.
        (t >= 0.0 && t.is_finite()).then_some(t)
    }

    fn distance(&self, point: Point) -> f64 {
        let along = self.to - self.from;
        let u = ((point - self.from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        (self.from + along * u - point).norm()
    }
}

impl Circle {
    /// Solves `|origin + t direction - centre| = radius` for the smallest t ahead; seen from inside that is the far side.
    fn range(&self, origin: Point, direction: Point) -> Option<f64> {
        let offset = self.centre - origin;
        let middle = offset.dot(&direction);
        let miss = perpendicular(direction).dot(&offset);
        if miss.abs() > self.radius {
            return None;
        }
        let half_chord = ((self.radius - miss) * (self.radius + miss)).sqrt();
        [middle - half_chord, middle + half_chord].into_iter().find(|&t| t >= 0.0)
    }

    fn distance(&self, point: Point) -> f64 {
        ((point - self.centre).norm() - self.radius).abs()
    }
}

/// A world made of line segments and circles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shapes {
    segments: Vec<Segment>,
    circles: Vec<Circle>,
}

impl Shapes {
    /// Adds walls from corner to corner.
    #[must_use]
    pub fn walls(mut self, corners: &[Point]) -> Self {
        self.segments.extend(corners.windows(2).map(|ends| Segment { from: ends[0], to: ends[1] }));
        self
    }

    /// Adds walls from corner to corner and back to the first.
    #[must_use]
    pub fn outline(self, corners: &[Point]) -> Self {
        let closing = [corners.last(), corners.first()].into_iter().flatten().copied().collect::<Vec<_>>();
        self.walls(corners).walls(&closing)
    }

    /// Adds a rectangle of `length` by `width`; `placed` takes its centre and axes to where it stands.
    #[must_use]
    pub fn block(self, placed: &RigidTransform, length: f64, width: f64) -> Self {
        let (x, y) = (0.5 * length, 0.5 * width);
        self.outline(&[(x, y), (-x, y), (-x, -y), (x, -y)].map(|(x, y)| placed.apply(Point::new(x, y))))
    }

    /// Adds a circle.
    #[must_use]
    pub fn pillar(mut self, centre: Point, radius: f64) -> Self {
        self.circles.push(Circle { centre, radius });
        self
    }
}

impl World for Shapes {
    fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64> {
        let segments = self.segments.iter().filter_map(|segment| segment.range(origin, direction));
        let circles = self.circles.iter().filter_map(|circle| circle.range(origin, direction));
        segments.chain(circles).filter(|&range| range <= max).min_by(f64::total_cmp)
    }

    fn clearance(&self, point: Point) -> f64 {
        let segments = self.segments.iter().map(|segment| segment.distance(point));
        let circles = self.circles.iter().map(|circle| circle.distance(point));
        segments.chain(circles).fold(f64::INFINITY, f64::min)
    }
}
