//! The rays of an instantaneous scan, and the selection of rays by direction.

use std::f64::consts::TAU;

use crate::geometry::{Point, Pose2, wrap_angle};
use crate::scan::BeamGeometry;

/// Evenly spaced rays from one origin.
#[derive(Clone, Debug)]
pub struct Rays {
    origin: Point,
    /// Direction of the first ray, rad.
    first: f64,
    /// Angle from one ray to the next, rad.
    increment: f64,
    directions: Vec<Point>,
}

impl Rays {
    /// The beams of a laser at a pose. They must be evenly spaced ([`BeamGeometry::is_uniform`]).
    pub fn new(beams: &BeamGeometry, pose: &Pose2) -> Self {
        debug_assert!(beams.is_uniform());
        let transform = pose.transform();
        let directions = beams.directions().iter().map(|&direction| transform.rotate(direction)).collect();
        Self { origin: pose.translation(), first: pose.theta + beams.angle(0), increment: beams.angle_increment(), directions }
    }

    /// The common origin.
    pub fn origin(&self) -> Point {
        self.origin
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Whether there are no rays.
    pub fn is_empty(&self) -> bool {
        self.directions.is_empty()
    }

    /// Unit vector of a ray.
    pub fn direction(&self, ray: usize) -> Point {
        self.directions[ray]
    }

    /// Indices of the rays that point into a sector, and of one or two on either side of it. Some indices may occur twice.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturates, as intended
    pub fn within(&self, sector: Sector) -> impl Iterator<Item = usize> + use<> {
        let count = self.len();
        let offset = if self.increment > 0.0 { sector.start - self.first } else { self.first - sector.start - sector.width };
        let beams = |angle: f64| angle / self.increment.abs();
        let (start, width, full_turn) = (beams(offset.rem_euclid(TAU)), beams(sector.width), beams(TAU));
        // Rays and sector each span up to a full turn: they can overlap in up to three index ranges.
        [-full_turn, 0.0, full_turn].into_iter().flat_map(move |shift| {
            let (first, end) = (start + shift - 1.0, start + shift + width + 2.0);
            (first as usize).min(count)..(end as usize).min(count)
        })
    }
}

/// A range of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sector {
    /// The first direction (rightmost), rad.
    start: f64,
    /// Angle counterclockwise from there to the last one, rad.
    width: f64,
}

impl Sector {
    /// All directions.
    pub const ALL: Self = Self { start: 0.0, width: TAU };

    /// The directions between those of two vectors, on the side where they are less than 180 degrees apart.
    pub fn between(a: Point, b: Point) -> Self {
        let (start, end) = (angle(a), angle(b));
        let difference = wrap_angle(end - start);
        Self { start: if difference < 0.0 { end } else { start }, width: difference.abs() }
    }

    /// The directions that differ by at most `half` rad from that of a vector.
    pub fn around(middle: Point, half: f64) -> Self {
        Self { start: angle(middle) - half, width: 2.0 * half }
    }
}

fn angle(v: Point) -> f64 {
    v.y.atan2(v.x)
}
