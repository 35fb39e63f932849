//! Worlds of line segments and circles, with exact ranges in closed form.

use crate::geometry::{Point, RigidTransform, perpendicular};

use super::rays::{Rays, Sector};
use super::world::World;

/// An obstacle for rays.
trait Shape {
    /// Range from `origin` along the unit vector `direction`, if the ray hits the shape.
    fn range(&self, origin: Point, direction: Point) -> Option<f64>;

    /// A sector that contains all directions in which the shape is visible from `origin`.
    fn sector(&self, origin: Point) -> Sector;

    /// Distance of the shape from `point`.
    fn distance(&self, point: Point) -> f64;
}

/// A thin straight wall.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment {
    from: Point,
    to: Point,
}

/// A thin circular wall.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Circle {
    centre: Point,
    radius: f64,
}

/// Rays that miss an end of a segment by this fraction of its length still hit it, so that no ray slips through a corner.
const END_TOLERANCE: f64 = 1e-12;
/// From points closer to a segment than this, m, it may be visible in any direction.
const TOUCH_DISTANCE: f64 = 1e-6;

impl Shape for Segment {
    /// Solves `origin + t direction = from + u (to - from)` for t, with u in 0..1.
    fn range(&self, origin: Point, direction: Point) -> Option<f64> {
        let along = self.to - self.from;
        let offset = self.from - origin;
        let determinant = direction.perp(&along);
        // u = numerator / denominator
        let (denominator, numerator) = (determinant.abs(), offset.perp(&direction) * determinant.signum());
        // Most rays miss most segments: this test needs no division.
        if numerator < -END_TOLERANCE * denominator || numerator > (1.0 + END_TOLERANCE) * denominator {
            return None;
        }
        let t = offset.perp(&along) / determinant;
        // A ray parallel to the segment has determinant 0, hence t infinite or NaN: a thin wall cannot be seen edge-on.
        (t >= 0.0 && t.is_finite()).then_some(t)
    }

    fn sector(&self, origin: Point) -> Sector {
        if self.distance(origin) < TOUCH_DISTANCE { Sector::ALL } else { Sector::between(self.from - origin, self.to - origin) }
    }

    fn distance(&self, point: Point) -> f64 {
        let along = self.to - self.from;
        let u = ((point - self.from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        (self.from + along * u - point).norm()
    }
}

impl Shape for Circle {
    /// Solves `|origin + t direction - centre| = radius` for the smallest t >= 0; from inside that is the far side.
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

    fn sector(&self, origin: Point) -> Sector {
        let (direction, distance) = (self.centre - origin, (self.centre - origin).norm());
        if distance <= self.radius { Sector::ALL } else { Sector::around(direction, (self.radius / distance).asin()) }
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

    /// Adds a rectangle of `length` by `width`; `placed` is the transform from its centre and axes to the world.
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

    /// Tests each shape only against the rays that may hit it.
    fn ranges(&self, rays: &Rays, max: f64) -> Vec<Option<f64>> {
        let mut ranges = vec![None; rays.len()];
        shorten(&mut ranges, rays, &self.segments, max);
        shorten(&mut ranges, rays, &self.circles, max);
        ranges
    }

    fn clearance(&self, point: Point) -> f64 {
        let segments = self.segments.iter().map(|segment| segment.distance(point));
        let circles = self.circles.iter().map(|circle| circle.distance(point));
        segments.chain(circles).fold(f64::INFINITY, f64::min)
    }
}

/// Shortens rays to the shapes that they hit within `max`.
fn shorten(ranges: &mut [Option<f64>], rays: &Rays, shapes: &[impl Shape], max: f64) {
    for shape in shapes {
        rays.within(shape.sector(rays.origin())).for_each(|ray| {
            let hit = shape.range(rays.origin(), rays.direction(ray));
            if let Some(range) = hit.filter(|&range| range <= max)
                && ranges[ray].is_none_or(|nearest| range < nearest)
            {
                ranges[ray] = Some(range);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use crate::scan::BeamGeometry;
    use crate::simulation::built_in::BuiltIn;
    use proptest::prelude::*;
    use std::f64::consts::TAU;

    /// Ends and midpoints of walls: rays are most easily lost at the ends.
    fn corners(world: &Shapes) -> Vec<Point> {
        world.segments.iter().flat_map(|wall| [wall.from, wall.to, 0.5 * (wall.from + wall.to)]).collect()
    }

    proptest! {
        #[test]
        fn a_whole_scan_equals_single_rays(
            which in prop::sample::select(vec![BuiltIn::Corridor, BuiltIn::Room]),
            (x, y, yaw) in (-15.0..15.0, -9.0..9.0, -4.0..4.0),
            corner in prop::option::weighted(0.2, any::<prop::sample::Index>()),
            (beams, view, clockwise) in (10_u32..1100, prop_oneof![Just(1.0), 0.1..1.0], any::<bool>()),
            max in 0.5..40.0,
        ) {
            let (world, _) = which.build();
            let origin = corner.map_or(Point::new(x, y), |corner| *corner.get(&corners(&world)));
            let increment = view * TAU / f64::from(beams - 1) * if clockwise { -1.0 } else { 1.0 };
            let beams = BeamGeometry::new(-0.5 * view * TAU, increment, beams as usize);
            let rays = Rays::new(&beams, &Pose2::new(origin.x, origin.y, yaw));
            let one_by_one: Vec<_> =
                (0..rays.len()).map(|ray| world.range(rays.origin(), rays.direction(ray), max)).collect();
            prop_assert_eq!(world.ranges(&rays, max), one_by_one);
        }
    }
}
