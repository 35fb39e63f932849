//! How far a beam goes in a map: several ways to say so, for as many poses and beams as a particle filter asks of.
//!
//! Everything here is in the units of the grid: lengths in cells, headings from the direction of its rows. Light passes unknown
//! cells, and nothing stands outside the map: the rule of [`OccupancyGrid::range`], which the tests hold every method against.
//!
//! To add a method: a file with a type that implements [`RayCaster`], a variant in [`RayCasting`] and a line in
//! [`RayCasting::caster`].

#![allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)] // cells: small numbers, checked at the door

mod bits;
mod bresenham;
mod cddt;
mod ray_marching;
mod table;

use std::f64::consts::TAU;
use std::ops::Range;

use crate::geometry::Pose2;
use crate::map::grid::OccupancyGrid;

/// Memory that nobody minds, bytes.
const MODERATE: usize = 256 << 20;

/// An angle as a fraction of a turn, in units of 2^-32: adding wraps by itself, and the leading bits are the index into a table.
pub type Turn = u32;

/// The angle, rad, as a fraction of a turn.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // wraps, as wanted
pub fn turn(angle: f64) -> Turn {
    (angle * (2.0_f64.powi(32) / TAU)).round() as i64 as Turn
}

/// The one of `count` equal sectors whose middle is nearest to `turn`; the middle of sector 0 is at 0.
#[inline]
#[allow(clippy::cast_possible_truncation)] // less than `count`
fn sector(turn: Turn, count: u32) -> usize {
    let shifted = turn.wrapping_add((1_u32 << 31) / count);
    ((u64::from(shifted) * u64::from(count)) >> 32) as usize
}

/// Where a fan of beams starts: a pose in the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Column, with its fraction.
    pub x: f32,
    /// Row, with its fraction.
    pub y: f32,
    /// Heading.
    pub turn: Turn,
    /// Cosine of the heading.
    pub cos: f32,
    /// Sine of the heading.
    pub sin: f32,
}

impl Viewpoint {
    /// A pose that the grid made of one of the map ([`OccupancyGrid::pose_in_cells`]).
    #[allow(clippy::cast_possible_truncation)] // a thousandth of a cell will do
    pub fn new(pose: &Pose2) -> Self {
        let (sin, cos) = pose.theta.sin_cos();
        Self { x: pose.x as f32, y: pose.y as f32, turn: turn(pose.theta), cos: cos as f32, sin: sin as f32 }
    }
}

/// A beam of a laser: its direction, seen from it.
#[derive(Clone, Copy, Debug)]
struct Beam {
    turn: Turn,
    x: f32,
    y: f32,
}

impl Beam {
    /// Its heading in the grid.
    #[inline]
    fn turn_from(&self, from: &Viewpoint) -> Turn {
        self.turn.wrapping_add(from.turn)
    }

    /// Its unit vector in the grid.
    #[inline]
    fn direction_from(&self, from: &Viewpoint) -> [f32; 2] {
        [from.cos * self.x - from.sin * self.y, from.sin * self.x + from.cos * self.y]
    }
}

/// Beams of a laser.
#[derive(Clone, Debug, Default)]
pub struct Fan {
    beams: Vec<Beam>,
}

impl Fan {
    /// Beams at these angles, rad, seen from the laser.
    #[allow(clippy::cast_possible_truncation)] // unit vectors
    pub fn new(angles: impl IntoIterator<Item = f64>) -> Self {
        let beam = |angle: f64| Beam { turn: turn(angle), x: angle.cos() as f32, y: angle.sin() as f32 };
        Self { beams: angles.into_iter().map(beam).collect() }
    }

    /// Some of the beams, by their numbers.
    #[must_use]
    pub fn part(&self, beams: Range<usize>) -> Self {
        Self { beams: self.beams[beams].to_vec() }
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.beams.len()
    }

    /// Whether there are no beams.
    pub fn is_empty(&self) -> bool {
        self.beams.is_empty()
    }

    /// Fills `lengths` beam by beam: from viewpoints near each other, the same beam meets the same walls, which stay in the cache.
    #[inline]
    fn fill(&self, from: &[Viewpoint], lengths: &mut [f32], length: impl Fn(&Viewpoint, &Beam) -> f32) {
        for (beam, lengths) in self.beams.iter().zip(lengths.chunks_exact_mut(from.len().max(1))) {
            for (from, result) in from.iter().zip(lengths) {
                *result = length(from, beam);
            }
        }
    }
}

/// A way to find how far beams go in one map.
pub trait RayCaster: Send + Sync {
    /// The lengths of all beams of `fan` from all viewpoints to the first wall, cells; infinite if there is none in reach or if the
    /// viewpoint is outside. First those of the first beam, from one viewpoint after the other, then those of the second, and so on.
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]);

    /// Memory that it holds, bytes.
    fn memory(&self) -> usize;
}

crate::choices! {
    /// The methods there are.
    pub enum RayCasting {
        /// Every cell that a beam touches, in integers: exact, no preparation.
        Bresenham = "bresenham",
        /// Leaps as long as the distance to the nearest wall, then cell by cell: exact.
        RayMarching = "ray_marching",
        /// Compressed directional distance transform (Walsh and Karaman, 2018): to half a cell and a quarter of a degree.
        Cddt = "cddt",
        /// Every answer computed beforehand, for the middle of every cell within walls and every degree: to half a cell and half a degree.
        Table = "table",
    }
}

impl RayCasting {
    /// The fastest method that takes a moderate amount of memory: the table, unless the map is large.
    pub fn fastest_for(grid: &OccupancyGrid) -> Self {
        if table::memory_for(grid) <= MODERATE { Self::Table } else { Self::Cddt }
    }

    /// Prepares this method for a map. Beams reach `max_range` cells.
    #[allow(clippy::cast_possible_truncation)] // cells
    pub fn caster(self, grid: &OccupancyGrid, max_range: f64) -> Box<dyn RayCaster> {
        let max_range = max_range as f32;
        match self {
            Self::Bresenham => Box::new(bresenham::Bresenham::new(grid, max_range)),
            Self::RayMarching => Box::new(ray_marching::RayMarching::new(grid, max_range)),
            Self::Cddt => Box::new(cddt::Cddt::new(grid, max_range)),
            Self::Table => Box::new(table::Table::new(grid, max_range)),
        }
    }
}
