//! The compressed directional distance transform (Walsh and Karaman, 2018).
//!
//! For each of many directions the map is cut into strips along it, and each strip keeps the places at which a beam in that
//! direction runs from free space into a wall, in order. The length of a beam is the way to the next such place in its strip.

use super::bits::WallBits;
use super::{Fan, RayCaster, Viewpoint, sector};
use crate::map::grid::OccupancyGrid;
use crate::parallel;

/// Directions of a full turn, unless others are wanted.
const DIRECTIONS: u32 = 720;
/// Places that are compared at once.
const BLOCK: usize = 8;
/// Stands after the last place of a strip.
const NO_PLACE: u16 = u16::MAX;
/// The largest place.
const LAST_PLACE: f32 = 65_000.0;
/// A gap between walls narrower than this is none: neighbouring cells, rounded, cells.
const GAP: f32 = 0.05;

/// Up to [`BLOCK`] places.
#[derive(Clone, Copy)]
#[repr(align(16))]
struct Places([u16; BLOCK]);

/// One direction: the turned frame, its origin at the lower left of the turned map.
#[derive(Clone, Copy)]
struct Direction {
    cos: f32,
    sin: f32,
    /// Added to the way along the direction and across it so that both are positive in the map.
    along: f32,
    across: f32,
    strips: u32,
    /// Index of its first strip.
    first: u32,
}

/// Walls ahead, by direction and strip.
pub(super) struct Cddt {
    walls: WallBits,
    /// Strips in the width of a cell.
    fineness: f32,
    directions: Vec<Direction>,
    /// First block of every strip, and the end.
    starts: Vec<u32>,
    blocks: Vec<Places>,
    /// Units of a place in a cell, and the inverse.
    units: f32,
    cells: f32,
    max_range: f32,
}

impl Cddt {
    pub(super) fn new(grid: &OccupancyGrid, max_range: f32) -> Self {
        Self::with(grid, max_range, DIRECTIONS, 1.0)
    }

    /// For so many directions, with `fineness` strips in the width of a cell.
    pub(super) fn with(grid: &OccupancyGrid, max_range: f32, directions: u32, fineness: f32) -> Self {
        let walls = WallBits::new(grid);
        let surface = surface(grid, &walls);
        let size = [grid.width() as f32, grid.height() as f32];
        let units = LAST_PLACE / size[0].hypot(size[1]).max(1.0);
        let strips = |index| Strips::new(direction(index, directions, size, fineness), &surface, units, fineness);
        let parts = parallel::map(0..directions, strips);
        let (mut directions, mut starts, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
        for Strips { mut direction, starts: own, blocks: own_blocks } in parts {
            direction.first = starts.len() as u32;
            starts.extend(own.iter().map(|start| start + blocks.len() as u32));
            blocks.extend(own_blocks);
            directions.push(direction);
        }
        starts.push(blocks.len() as u32);
        Self { walls, fineness, directions, starts, blocks, units, cells: units.recip(), max_range }
    }

    /// The length of all beams from a place within a wall, or outside the map; `None` anywhere else. Strips know where walls begin, not
    /// what is within them.
    pub(super) fn length_at_once(&self, from: &Viewpoint) -> Option<f32> {
        match self.walls.index(from.x, from.y) {
            None => Some(f32::INFINITY),
            Some(start) => self.walls.stops(start).then_some(0.0),
        }
    }

    /// The length of a beam in one of the directions.
    #[inline]
    pub(super) fn length(&self, from: &Viewpoint, direction: usize) -> f32 {
        let Direction { cos, sin, along, across, strips, first } = self.directions[direction];
        let here = ((from.x * cos + from.y * sin + along) * self.units) as u16;
        let strip = (((from.y * cos - from.x * sin + across) * self.fineness) as u32).min(strips - 1);
        let strip = (first + strip) as usize;
        let (start, end) = (self.starts[strip] as usize, self.starts[strip + 1] as usize);
        for Places(places) in &self.blocks[start..end] {
            if places[BLOCK - 1] >= here {
                let passed: usize = places.iter().map(|&place| usize::from(place < here)).sum();
                let place = places[passed.min(BLOCK - 1)];
                let length = f32::from(place - here) * self.cells;
                return if place == NO_PLACE || length > self.max_range { f32::INFINITY } else { length };
            }
        }
        f32::INFINITY
    }
}

/// The middles of the wall cells that a beam can hit: those next to one that is no wall.
fn surface(grid: &OccupancyGrid, walls: &WallBits) -> Vec<[f32; 2]> {
    let stride = walls.stride();
    let is_wall = |index| walls.stops(index) && !walls.is_border(index);
    let mut middles = Vec::new();
    for row in 0..grid.height() {
        for column in 0..grid.width() {
            let index = (row + 1) * stride + column + 1;
            if is_wall(index) && [index - 1, index + 1, index - stride, index + stride].into_iter().any(|next| !is_wall(next)) {
                middles.push([column as f32 + 0.5, row as f32 + 0.5]);
            }
        }
    }
    middles
}

fn direction(index: u32, count: u32, [width, height]: [f32; 2], fineness: f32) -> Direction {
    let (sin, cos) = (f64::from(index) * std::f64::consts::TAU / f64::from(count)).sin_cos();
    let (sin, cos) = (sin as f32, cos as f32);
    let along = (-width * cos).max(0.0) + (-height * sin).max(0.0);
    let across = (width * sin).max(0.0) + (-height * cos).max(0.0);
    let strips = ((width * sin.abs() + height * cos.abs()) * fineness).ceil() as u32 + 1;
    Direction { cos, sin, along, across, strips, first: 0 }
}

/// The strips of one direction.
struct Strips {
    direction: Direction,
    starts: Vec<u32>,
    blocks: Vec<Places>,
}

impl Strips {
    fn new(direction: Direction, surface: &[[f32; 2]], units: f32, fineness: f32) -> Self {
        let mut crossings: Vec<Vec<(f32, f32)>> = vec![Vec::new(); direction.strips as usize];
        for &middle in surface {
            add_crossings(&direction, middle, fineness, &mut crossings);
        }
        let (mut starts, mut blocks) = (Vec::with_capacity(crossings.len()), Vec::new());
        for strip in &mut crossings {
            starts.push(blocks.len() as u32);
            strip.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            let mut left = f32::NEG_INFINITY;
            let mut places = Vec::new();
            for &(enter, leave) in strip.iter() {
                if enter > left + GAP {
                    places.push((enter.max(0.0) * units).min(LAST_PLACE) as u16);
                }
                left = left.max(leave);
            }
            blocks.extend(places.chunks(BLOCK).map(|chunk| {
                let mut block = [NO_PLACE; BLOCK];
                block[..chunk.len()].copy_from_slice(chunk);
                Places(block)
            }));
        }
        Self { direction, starts, blocks }
    }
}

/// Where the middle line of each strip enters and leaves a wall cell.
fn add_crossings(direction: &Direction, [x, y]: [f32; 2], fineness: f32, strips: &mut [Vec<(f32, f32)>]) {
    let Direction { cos, sin, along, across, .. } = *direction;
    let (u, v) = (x * cos + y * sin + along, y * cos - x * sin + across);
    let half = 0.5 * (cos.abs() + sin.abs());
    let strip_at = |v: f32| v * fineness - 0.5;
    let (lowest, highest) = (strip_at(v - half).ceil().max(0.0) as usize, strip_at(v + half).floor().max(0.0) as usize);
    for (strip, crossings) in strips.iter_mut().enumerate().take(highest + 1).skip(lowest) {
        let offset = (strip as f32 + 0.5) / fineness - v;
        // Within the cell, the line passes two pairs of sides.
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
        fan.fill(from, lengths, |from, beam| self.length(from, sector(beam.turn_from(from), self.directions.len() as u32)));
        for (view, from_here) in from.iter().enumerate() {
            let Some(length) = self.length_at_once(from_here) else { continue };
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
