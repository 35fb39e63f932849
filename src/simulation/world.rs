//! The interface of simulated worlds: ray casting for the laser, and clearance for the car.

use crate::geometry::Point;

use super::rays::Rays;

/// A world with walls.
pub trait World: Sync {
    /// Distance from `origin` along the unit vector `direction` to the nearest wall, m; `None` if there is none within `max`.
    fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64>;

    /// The [`range`](Self::range) of each ray; implementations may be faster than casting each ray separately.
    fn ranges(&self, rays: &Rays, max: f64) -> Vec<Option<f64>> {
        (0..rays.len()).map(|ray| self.range(rays.origin(), rays.direction(ray), max)).collect()
    }

    /// A lower bound of the distance from `point` to the nearest obstacle, m; 0 where the car must not be.
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
