//! Ray casting in a map: several methods, fast enough for the poses and beams of a particle filter.
//!
//! All quantities are in grid units: lengths in cells, headings relative to the direction of the rows. Beams pass through unknown
//! cells, and there are no obstacles outside the map. [`OccupancyGrid::range`] follows the same rules; the tests compare every method
//! with it.
//!
//! To add a method, write a file with a type that implements [`RayCaster`], and add a variant to [`RayCasting`] and a line to
//! [`RayCasting::caster`].

#![allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)] // cells: small numbers, checked on input

mod bits;
mod bresenham;
mod cddt;
mod ray_marching;
mod table;

use std::f64::consts::TAU;
use std::ops::Range;

use crate::geometry::Pose2;
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;
use table::Table;

/// Maximum memory of a look-up table that is chosen automatically, bytes.
const MAX_TABLE_MEMORY: usize = 256 << 20;

/// An angle in units of 2^-32 of a full rotation: addition wraps around, and the leading bits are an index into a table.
pub type BinaryAngle = u32;

/// Converts an angle from rad.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // wraps, as intended
pub fn binary_angle(angle: f64) -> BinaryAngle {
    (angle * (2.0_f64.powi(32) / TAU)).round() as i64 as BinaryAngle
}

/// Index of the one of `count` equal sectors that contains `angle`; sector 0 is centred at 0.
#[inline]
#[allow(clippy::cast_possible_truncation)] // less than `count`
fn sector(angle: BinaryAngle, count: u32) -> usize {
    let shifted = angle.wrapping_add((1_u32 << 31) / count);
    ((u64::from(shifted) * u64::from(count)) >> 32) as usize
}

/// Start of a fan of beams: a pose in the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Fractional column.
    pub x: f32,
    /// Fractional row.
    pub y: f32,
    /// Heading.
    pub heading: BinaryAngle,
    /// Cosine of the heading.
    pub cos: f32,
    /// Sine of the heading.
    pub sin: f32,
}

impl Viewpoint {
    /// Converts a pose in the grid, as returned by [`OccupancyGrid::pose_in_cells`].
    #[allow(clippy::cast_possible_truncation)] // a thousandth of a cell is enough
    pub fn new(pose: &Pose2) -> Self {
        let (sin, cos) = pose.theta.sin_cos();
        Self { x: pose.x as f32, y: pose.y as f32, heading: binary_angle(pose.theta), cos: cos as f32, sin: sin as f32 }
    }
}

/// Direction of a beam in the laser's frame.
#[derive(Clone, Copy, Debug)]
struct Beam {
    angle: BinaryAngle,
    x: f32,
    y: f32,
}

impl Beam {
    /// Heading of the beam in the grid.
    #[inline]
    fn heading_from(&self, from: &Viewpoint) -> BinaryAngle {
        self.angle.wrapping_add(from.heading)
    }

    /// Unit vector of the beam in the grid.
    #[inline]
    fn direction_from(&self, from: &Viewpoint) -> [f32; 2] {
        [from.cos * self.x - from.sin * self.y, from.sin * self.x + from.cos * self.y]
    }
}

/// A fan of beams of a laser.
#[derive(Clone, Debug, Default)]
pub struct Fan {
    beams: Vec<Beam>,
}

impl Fan {
    /// Creates beams at these angles in the laser's frame, rad.
    #[allow(clippy::cast_possible_truncation)] // unit vectors
    pub fn new(angles: impl IntoIterator<Item = f64>) -> Self {
        let beam = |angle: f64| Beam { angle: binary_angle(angle), x: angle.cos() as f32, y: angle.sin() as f32 };
        Self { beams: angles.into_iter().map(beam).collect() }
    }

    /// A subset of the beams, by index.
    #[must_use]
    pub fn subset(&self, beams: Range<usize>) -> Self {
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

    /// Fills `lengths` beam by beam: from nearby viewpoints, the same beam hits the same walls, which stay in the cache.
    #[inline]
    fn fill(&self, from: &[Viewpoint], lengths: &mut [f32], length: impl Fn(&Viewpoint, &Beam) -> f32) {
        for (beam, lengths) in self.beams.iter().zip(lengths.chunks_exact_mut(from.len().max(1))) {
            for (from, result) in from.iter().zip(lengths) {
                *result = length(from, beam);
            }
        }
    }
}

/// A ray casting method, prepared for one map.
pub trait RayCaster: Send + Sync {
    /// Computes the lengths of all beams of `fan` from all viewpoints to the first wall, cells; infinite if there is no wall within
    /// range, or if the viewpoint is outside the map. `lengths` is ordered by beam, then by viewpoint.
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]);

    /// Memory in use, bytes.
    fn memory(&self) -> usize;
}

crate::choices! {
    /// Ray casting methods.
    pub enum RayCasting {
        /// Checks every cell that a beam touches, in integer arithmetic: exact, no precomputation.
        Bresenham = "bresenham",
        /// Leaps by the distance to the nearest wall, then cell by cell: exact.
        RayMarching = "ray_marching",
        /// Compressed directional distance transform (Walsh and Karaman, 2018): accurate to half a cell and a quarter of a degree.
        Cddt = "cddt",
        /// Precomputed look-up table for the centre of every indoor cell and every degree: accurate to half a cell and half a degree.
        Table = "table",
    }
}

impl RayCasting {
    /// Prepares the fastest method with moderate memory use for a map: the table, unless the map is large.
    #[allow(clippy::cast_possible_truncation)] // cells
    pub fn fastest_caster(grid: &OccupancyGrid, max_range: f64) -> Box<dyn RayCaster> {
        match Table::within(MAX_TABLE_MEMORY, grid, max_range as f32) {
            Some(table) => Box::new(table),
            None => Self::Cddt.caster(grid, max_range),
        }
    }

    /// Prepares this method for a map; `max_range` is the maximum length of a beam, cells.
    #[allow(clippy::cast_possible_truncation)] // cells
    pub fn caster(self, grid: &OccupancyGrid, max_range: f64) -> Box<dyn RayCaster> {
        let max_range = max_range as f32;
        match self {
            Self::Bresenham => Box::new(bresenham::Bresenham::new(grid, max_range)),
            Self::RayMarching => Box::new(ray_marching::RayMarching::new(grid, max_range)),
            Self::Cddt => Box::new(cddt::Cddt::new(grid, max_range)),
            Self::Table => Box::new(Table::new(grid, &indoor_cells(grid), max_range)),
        }
    }
}
