//! The compressed directional distance transform (Walsh and Karaman, 2018).
//!
//! For each of many directions, the map is divided into strips along it. Each strip stores the sorted positions at which a beam in that
//! direction enters a wall. The length of a beam is the distance to the next such position in its strip.

use super::bits::WallBits;
use super::{Fan, RayCaster, Viewpoint, sector};
use crate::map::grid::OccupancyGrid;
use crate::parallel;

/// Default number of directions.
const DIRECTIONS: u32 = 720;
/// Number of positions that are compared at once.
const BLOCK: usize = 8;
/// Padding after the last position of a strip.
const NO_POSITION: u16 = u16::MAX;
/// Largest position.
const MAX_POSITION: f32 = 65_000.0;
/// Gaps between walls narrower than this are ignored, cells: they are rounding errors between neighbouring cells.
const MIN_GAP: f32 = 0.05;

/// Up to [`BLOCK`] positions.
#[derive(Clone, Copy)]
#[repr(align(16))]
struct Positions([u16; BLOCK]);

/// One direction: the rotated frame, with its origin at the lower left of the rotated map.
#[derive(Clone, Copy)]
struct Direction {
    cos: f32,
    sin: f32,
    /// Offset of the coordinate along the direction that makes it positive within the map, cells.
    along: f32,
    /// Offset of the coordinate across the direction that makes it positive within the map, cells.
    across: f32,
    strips: u32,
    /// Index of the first strip.
    first: u32,
}

/// The transform: positions of walls by direction and strip.
pub(super) struct Cddt {
    walls: WallBits,
    /// Number of strips per cell width.
    strips_per_cell: f32,
    directions: Vec<Direction>,
    /// First block of every strip, and the end of the last one.
    starts: Vec<u32>,
    blocks: Vec<Positions>,
    /// Position units per cell.
    units: f32,
    /// Cells per position unit.
    cells: f32,
    max_range: f32,
}

impl Cddt {
    pub(super) fn new(grid: &OccupancyGrid, max_range: f32) -> Self {
        Self::with(grid, max_range, DIRECTIONS, 1.0)
    }

    /// Creates the transform with this number of directions and of strips per cell width.
    pub(super) fn with(grid: &OccupancyGrid, max_range: f32, directions: u32, strips_per_cell: f32) -> Self {
        let walls = WallBits::new(grid);
        let surface = surface(grid, &walls);
        let size = [grid.width() as f32, grid.height() as f32];
        let units = MAX_POSITION / size[0].hypot(size[1]).max(1.0);
        let strips = |index| Strips::new(direction(index, directions, size, strips_per_cell), &surface, units, strips_per_cell);
        let results = parallel::map(0..directions, strips);
        let (mut directions, mut starts, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
        for Strips { mut direction, starts: own, blocks: own_blocks } in results {
            direction.first = starts.len() as u32;
            starts.extend(own.iter().map(|start| start + blocks.len() as u32));
            blocks.extend(own_blocks);
            directions.push(direction);
        }
        starts.push(blocks.len() as u32);
        Self { walls, strips_per_cell, directions, starts, blocks, units, cells: units.recip(), max_range }
    }

    /// The length of all beams from a position within a wall or outside the map, which the strips do not cover; `None` anywhere else.
    pub(super) fn special_length(&self, from: &Viewpoint) -> Option<f32> {
        match self.walls.index(from.x, from.y) {
            None => Some(f32::INFINITY),
            Some(start) => self.walls.stops(start).then_some(0.0),
        }
    }

    /// The length of a beam in one of the directions, cells.
    #[inline]
    pub(super) fn length(&self, from: &Viewpoint, direction: usize) -> f32 {
        let Direction { cos, sin, along, across, strips, first } = self.directions[direction];
        let here = ((from.x * cos + from.y * sin + along) * self.units) as u16;
        let strip = (((from.y * cos - from.x * sin + across) * self.strips_per_cell) as u32).min(strips - 1);
        let strip = (first + strip) as usize;
        let (start, end) = (self.starts[strip] as usize, self.starts[strip + 1] as usize);
        for Positions(positions) in &self.blocks[start..end] {
            if positions[BLOCK - 1] >= here {
                let passed: usize = positions.iter().map(|&position| usize::from(position < here)).sum();
                let position = positions[passed.min(BLOCK - 1)];
                let length = f32::from(position - here) * self.cells;
                return if position == NO_POSITION || length > self.max_range { f32::INFINITY } else { length };
            }
        }
        f32::INFINITY
    }
}

/// Centres of the wall cells that a beam can hit: those next to a cell without a wall.
fn surface(grid: &OccupancyGrid, walls: &WallBits) -> Vec<[f32; 2]> {
    let stride = walls.stride();
    let is_wall = |index| walls.stops(index) && !walls.is_border(index);
    let mut centres = Vec::new();
    for row in 0..grid.height() {
        for column in 0..grid.width() {
            let index = (row + 1) * stride + column + 1;
            if is_wall(index) && [index - 1, index + 1, index - stride, index + stride].into_iter().any(|next| !is_wall(next)) {
                centres.push([column as f32 + 0.5, row as f32 + 0.5]);
            }
        }
    }
    centres
}

fn direction(index: u32, count: u32, [width, height]: [f32; 2], strips_per_cell: f32) -> Direction {
    let (sin, cos) = (f64::from(index) * std::f64::consts::TAU / f64::from(count)).sin_cos();
    let (sin, cos) = (sin as f32, cos as f32);
    let along = (-width * cos).max(0.0) + (-height * sin).max(0.0);
    let across = (width * sin).max(0.0) + (-height * cos).max(0.0);
    let strips = ((width * sin.abs() + height * cos.abs()) * strips_per_cell).ceil() as u32 + 1;
    Direction { cos, sin, along, across, strips, first: 0 }
}

/// The strips of one direction.
struct Strips {
    direction: Direction,
    starts: Vec<u32>,
    blocks: Vec<Positions>,
}

impl Strips {
    fn new(direction: Direction, surface: &[[f32; 2]], units: f32, strips_per_cell: f32) -> Self {
        let mut crossings: Vec<Vec<(f32, f32)>> = vec![Vec::new(); direction.strips as usize];
        for &centre in surface {
            add_crossings(&direction, centre, strips_per_cell, &mut crossings);
        }
        let (mut starts, mut blocks) = (Vec::with_capacity(crossings.len()), Vec::new());
        for strip in &mut crossings {
            starts.push(blocks.len() as u32);
            strip.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            let mut last_exit = f32::NEG_INFINITY;
            let mut positions = Vec::new();
            for &(enter, leave) in strip.iter() {
                if enter > last_exit + MIN_GAP {
                    positions.push((enter.max(0.0) * units).min(MAX_POSITION) as u16);
                }
                last_exit = last_exit.max(leave);
            }
            blocks.extend(positions.chunks(BLOCK).map(|chunk| {
                let mut block = [NO_POSITION; BLOCK];
                block[..chunk.len()].copy_from_slice(chunk);
                Positions(block)
            }));
        }
        Self { direction, starts, blocks }
    }
}

/// Adds the positions at which the centre line of each strip enters and leaves a wall cell.
fn add_crossings(direction: &Direction, [x, y]: [f32; 2], strips_per_cell: f32, strips: &mut [Vec<(f32, f32)>]) {
    let Direction { cos, sin, along, across, .. } = *direction;
    let (u, v) = (x * cos + y * sin + along, y * cos - x * sin + across);
    let half = 0.5 * (cos.abs() + sin.abs());
    let strip_at = |v: f32| v * strips_per_cell - 0.5;
    let (lowest, highest) = (strip_at(v - half).ceil().max(0.0) as usize, strip_at(v + half).floor().max(0.0) as usize);
    for (strip, crossings) in strips.iter_mut().enumerate().take(highest + 1).skip(lowest) {
        let offset = (strip as f32 + 0.5) / strips_per_cell - v;
        // The line crosses two pairs of sides of the cell.
        let pass = |speed: f32, aside: f32| {
            let speed = speed.abs().max(1e-6);
            ((aside - 0.5) / speed, (aside + 0.5) / speed)
        };
        let (x_in, x_out) = pass(cos, offset * sin * cos.signum());
        let (y_in, y_out) = pass(sin, -offset * cos * sin.signum());
        let (enter, leave) = (x_in.max(y_in), x_out.min(y_out));
        if enter < leave {
            crossings.push((u + enter, u + leave));
        }
    }
}

impl RayCaster for Cddt {
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]) {
        fan.fill(from, lengths, |from, beam| self.length(from, sector(beam.heading_from(from), self.directions.len() as u32)));
        for (view, from_here) in from.iter().enumerate() {
            let Some(length) = self.special_length(from_here) else { continue };
            lengths.iter_mut().skip(view).step_by(from.len()).take(fan.len()).for_each(|result| *result = length);
        }
    }

    fn memory(&self) -> usize {
        self.walls.memory()
            + size_of_val(self.directions.as_slice())
            + size_of_val(self.starts.as_slice())
            + size_of_val(self.blocks.as_slice())
    }
}
