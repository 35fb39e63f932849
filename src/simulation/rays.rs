//! The rays of a scan taken in an instant, and which of them look where.

use std::f64::consts::TAU;

use crate::geometry::{Point, Pose2, wrap_angle};
use crate::scan::BeamGeometry;

/// Rays from one place, evenly spaced.
#[derive(Clone, Debug)]
pub struct Rays {
    origin: Point,
    /// Direction of the first one, rad.
    first: f64,
    /// Angle from one to the next, rad.
    increment: f64,
    directions: Vec<Point>,
}

impl Rays {
    /// The beams of a laser at this pose, which point where their indices say ([`BeamGeometry::is_even`]).
    pub fn new(beams: &BeamGeometry, pose: &Pose2) -> Self {
        debug_assert!(beams.is_even());
        let turn = pose.transform();
        let directions = beams.directions().iter().map(|&direction| turn.rotate(direction)).collect();
        Self { origin: pose.translation(), first: pose.theta + beams.angle(0), increment: beams.angle_increment(), directions }
    }

    /// Where they begin.
    pub fn origin(&self) -> Point {
        self.origin
    }

    /// How many they are.
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.directions.is_empty()
    }

    /// Unit vector of one.
    pub fn direction(&self, ray: usize) -> Point {
        self.directions[ray]
    }

    /// Numbers of the rays that look into a sector, and of one or two on either side of it; some perhaps twice.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // saturates, as wanted
    pub fn within(&self, sector: Sector) -> impl Iterator<Item = usize> + use<> {
        let count = self.len();
        let onwards = if self.increment > 0.0 { sector.start - self.first } else { self.first - sector.start - sector.width };
        let beams = |angle: f64| angle / self.increment.abs();
        let (start, width, turn) = (beams(onwards.rem_euclid(TAU)), beams(sector.width), beams(TAU));
        // Up to a turn of rays and up to a turn of directions meet up to three times.
        [-turn, 0.0, turn].into_iter().flat_map(move |turn| {
            let (before, behind) = (start + turn - 1.0, start + turn + width + 2.0);
            (before as usize).min(count)..(behind as usize).min(count)
        })
    }
}

/// Directions between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sector {
    /// The rightmost one, rad.
    start: f64,
    /// Angle from there to the leftmost one, rad.
    width: f64,
}

impl Sector {
    /// All directions.
    pub const ALL: Self = Self { start: 0.0, width: TAU };

    /// The directions between those of two vectors, less than half a turn apart.
    pub fn between(a: Point, b: Point) -> Self {
        let (start, end) = (angle(a), angle(b));
        let turn = wrap_angle(end - start);
        Self { start: if turn < 0.0 { end } else { start }, width: turn.abs() }
    }

    /// The directions that are at most `half` rad from that of a vector.
    pub fn about(middle: Point, half: f64) -> Self {
        Self { start: angle(middle) - half, width: 2.0 * half }
    }
}

fn angle(v: Point) -> f64 {
    v.y.atan2(v.x)
}
