//! What a simulated laser sees and a simulated car must not touch.

use crate::geometry::Point;

use super::rays::Rays;

/// A place with walls.
pub trait World: Sync {
    /// Distance from `origin` along the unit vector `direction` to the nearest wall, m; `None` if there is none within `max`.
    fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64>;

    /// The [`range`](Self::range) of each ray; a world may know a faster way than one after the other.
    fn ranges(&self, rays: &Rays, max: f64) -> Vec<Option<f64>> {
        (0..rays.len()).map(|ray| self.range(rays.origin(), rays.direction(ray), max)).collect()
    }

    /// A distance around `point` that is known to be clear, m: at most the true distance to what one could hit, 0 where one must not be.
    fn clearance(&self, point: Point) -> f64;
}

impl<W: World + ?Sized> World for &W {
    fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64> {
        (**self).range(origin, direction, max)
    }

    fn ranges(&self, rays: &Rays, max: f64) -> Vec<Option<f64>> {
        (**self).ranges(rays, max)
    }

    fn clearance(&self, point: Point) -> f64 {
        (**self).clearance(point)
    }
}
