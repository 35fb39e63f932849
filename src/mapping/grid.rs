//! Occupancy grid that counts hits and passes of rays.
//!
//! Each cell counts the rays that end in it (hits) and those that cross it (passes). A cell is occupied if more than a quarter of its
//! rays end in it, and at least three do. People who walked by vanish, because later rays pass there. Far away, where rays are sparse,
//! three hits in the cell and its neighbours together are enough, unless a neighbour has many more hits. Two rules keep walls free of
//! holes (figures in docs/maps.md):
//! - A ray ends at the front of a surface, so its hit counts in the cell half a cell further into the surface, along the normal. Along
//!   the ray, hits of grazing rays would not get into the wall.
//! - A ray passes the cells along its Bresenham line, not those whose corner it clips, and only up to half a cell in front of the
//!   surface it hits.
//!
//! Rays without a return are ignored here: glass, dark surfaces and free space give the same reading.

use crate::geometry::{Point, Pose2, perpendicular};
use crate::map::grid::{Cell, GridError, OccupancyGrid};

/// Minimum number of hits of an occupied cell.
const MIN_HITS: u32 = 3;
/// An occupied cell must have fewer passes per hit than this.
const MAX_PASSES_PER_HIT: u32 = 3;
/// A cell with fewer hits than [`MIN_HITS`] is not occupied if a neighbour has more than this many times its hits: they are then noise
/// of the neighbour's rays.
const MAX_NEIGHBOUR_RATIO: u32 = 2;
/// Minimum number of passes of a free cell: single rays come through gaps and windows.
const MIN_PASSES: u32 = 2;
/// Maximum distance from a line, m, for three neighbouring end points to lie on one surface.
const MAX_LINE_DEVIATION: f64 = 0.05;
/// Number of extra cells whenever a side of the grid grows.
const GROWTH_CELLS: i64 = 128;
/// Further extra cells: the side length divided by this, so that the grid seldom grows.
const GROWTH_DIVISOR: i64 = 4;
/// Maximum number of cells, so that a diverged pose does not exhaust the memory: 5 km^2 at 5 cm.
const MAX_CELLS: i64 = 1 << 31;

/// Number of fractional bits of the fixed-point row along a ray.
const FRACTION_BITS: u32 = 24;
/// Factor from cells to fixed-point rows.
const FIXED_POINT_ONE: f64 = (1_u32 << FRACTION_BITS) as f64;

/// End points of a scan's rays in the laser's frame, in the order of the rays, m; NaN for rays without a return.
pub(super) type EndPoints = [[f32; 2]];

/// Hit and pass counts of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evidence {
    /// Number of rays that ended in the cell.
    pub hits: u32,
    /// Number of rays that passed the cell.
    pub passes: u32,
}

impl Evidence {
    /// Classifies the cell, given the counts of the neighbouring cells.
    fn classify(self, around: impl Iterator<Item = Self>) -> Cell {
        let Self { hits, passes } = self;
        if hits == 0 || MAX_PASSES_PER_HIT.saturating_mul(hits) <= passes {
            return if passes >= MIN_PASSES { Cell::Free } else { Cell::Unknown };
        }
        let (mut sum, mut max) = (hits, 0);
        if hits < MIN_HITS {
            around.for_each(|other| (sum, max) = (sum.saturating_add(other.hits), max.max(other.hits)));
        }
        if sum >= MIN_HITS && MAX_NEIGHBOUR_RATIO * hits >= max { Cell::Occupied } else { Cell::Unknown }
    }
}

/// Hit and pass counts of all cells. The grid grows as scans are inserted.
#[derive(Clone, Debug)]
pub struct EvidenceGrid {
    resolution: f64,
    /// Column and row of the lower left cell, counted from the map's origin.
    first: [i64; 2],
    width: i64,
    height: i64,
    cells: Vec<Evidence>,
}

impl EvidenceGrid {
    /// Creates an empty grid; `resolution` is the side length of a cell, m. Cell boundaries are multiples of it, so two maps of one
    /// frame share them.
    pub fn new(resolution: f64) -> Self {
        Self { resolution, first: [0, 0], width: 0, height: 0, cells: Vec::new() }
    }

    /// Inserts a scan taken at the given pose of the laser.
    pub(super) fn insert(&mut self, points: &EndPoints, map_from_laser: &Pose2) {
        self.count(points, map_from_laser, |count| count.saturating_add(1));
    }

    /// Undoes [`Self::insert`] of a scan at the same pose.
    pub(super) fn remove(&mut self, points: &EndPoints, map_from_laser: &Pose2) {
        self.count(points, map_from_laser, |count| count.saturating_sub(1));
    }

    /// Applies `change` to the hits and passes of all cells along the rays of a scan.
    fn count(&mut self, points: &EndPoints, map_from_laser: &Pose2, change: impl Fn(u32) -> u32) {
        let transform = map_from_laser.transform();
        let ends: Vec<Point> = points.iter().map(|&[x, y]| transform.apply(Point::new(x.into(), y.into()))).collect();
        let laser = map_from_laser.translation();
        if !self.make_room(std::iter::once(&laser).chain(&ends)) {
            return;
        }
        for (i, end) in ends.iter().enumerate() {
            let ray = end - laser;
            let range = ray.norm();
            if !(range.is_finite() && range > 0.0) {
                continue;
            }
            let direction = ray / range;
            let into = into_surface(&ends, i, &direction);
            let half = 0.5 * self.resolution;
            let hit = self.index(self.column_and_row(&(end + into * half)));
            self.pass(&laser, &direction, range - half / into.dot(&direction), hit, &change);
            if let Some(cell) = self.cells.get_mut(hit) {
                cell.hits = change(cell.hits);
            }
        }
    }

    /// Counts a pass in the cells along the first `length` metres of a ray, except the cell it hits: in each column (or row, for a
    /// steep ray) the cell whose centre is nearest to the ray (Bresenham 1965). A cell whose corner the ray clips gives little
    /// evidence.
    #[allow(clippy::cast_possible_truncation)] // saturates
    fn pass(&mut self, from: &Point, direction: &Point, length: f64, hit: usize, change: &impl Fn(u32) -> u32) {
        let along = usize::from(direction.x.abs() < direction.y.abs());
        let across = 1 - along;
        let strides = [1, self.width];
        let first = self.first.map(|cell| cell as f64);
        let centre = |axis: usize, position: f64| position / self.resolution - first[axis] - 0.5;
        let (start, end) = (centre(along, from[along]), centre(along, from[along] + direction[along] * length));
        let forwards = direction[along] > 0.0;
        let (column, last) = if forwards { (start.ceil(), end.floor()) } else { (start.floor(), end.ceil()) };
        let slope = direction[across] / direction[along].abs();
        let row = centre(across, from[across]) + 0.5 + (column - start).abs() * slope;
        let (mut row, step) = ((row * FIXED_POINT_ONE) as i64, (slope * FIXED_POINT_ONE) as i64);
        let mut cell_index = column as i64 * strides[along];
        let stride = if forwards { strides[along] } else { -strides[along] };
        let columns = if forwards { last - column } else { column - last };
        for _ in 0..=columns as i64 {
            let index = usize::try_from(cell_index + (row >> FRACTION_BITS) * strides[across]).unwrap_or(usize::MAX);
            if index != hit
                && let Some(cell) = self.cells.get_mut(index)
            {
                cell.passes = change(cell.passes);
            }
            (cell_index, row) = (cell_index + stride, row + step);
        }
    }

    /// Column and row of a point, counted from the map's origin.
    #[allow(clippy::cast_possible_truncation)] // saturates
    fn column_and_row(&self, point: &Point) -> [i64; 2] {
        [(point.x / self.resolution).floor() as i64, (point.y / self.resolution).floor() as i64]
    }

    /// Index of a cell in `cells`; past the end if it is outside the grid.
    fn index(&self, [column, row]: [i64; 2]) -> usize {
        let (x, y) = (column - self.first[0], row - self.first[1]);
        let is_inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        if is_inside { usize::try_from(y * self.width + x).unwrap_or(usize::MAX) } else { usize::MAX }
    }

    /// Grows the grid to contain all points with a margin of one cell; returns false if it cannot.
    fn make_room<'a>(&mut self, points: impl Iterator<Item = &'a Point>) -> bool {
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        for point in points.filter(|point| point.x.is_finite() && point.y.is_finite()) {
            for (i, cell) in self.column_and_row(point).into_iter().enumerate() {
                low[i] = low[i].min(cell.saturating_sub(1));
                high[i] = high[i].max(cell.saturating_add(1));
            }
        }
        let size = [self.width, self.height];
        if low[0] > high[0] {
            return false;
        }
        if self.cells.is_empty() {
            (self.first, self.width, self.height) = (low, 0, 0);
        } else if (0..2).all(|i| low[i] >= self.first[i] && high[i] < self.first[i] + size[i]) {
            return true;
        }
        let growth = size.map(|side| GROWTH_CELLS + side / GROWTH_DIVISOR);
        let first = [0, 1].map(|i| if low[i] < self.first[i] { low[i].saturating_sub(growth[i]) } else { self.first[i] });
        let end = [0, 1].map(|i| {
            let end = self.first[i] + size[i];
            if high[i] >= end { high[i].saturating_add(growth[i]) } else { end }
        });
        let (width, height) = (end[0].saturating_sub(first[0]), end[1].saturating_sub(first[1]));
        if width.saturating_mul(height) > MAX_CELLS {
            return false;
        }
        let mut grown = Self { resolution: self.resolution, first, width, height, cells: Vec::new() };
        grown.cells = vec![Evidence::default(); usize::try_from(width * height).unwrap_or_default()];
        for row in 0..self.height {
            let [from, to] = [&*self, &grown].map(|grid| grid.index([self.first[0], self.first[1] + row]));
            let count = usize::try_from(self.width).unwrap_or_default();
            if count > 0 {
                grown.cells[to..to + count].copy_from_slice(&self.cells[from..from + count]);
            }
        }
        *self = grown;
        true
    }

    /// The map, cropped to its known cells and a margin of one cell; `None` if no cell is known.
    pub fn to_map(&self) -> Option<Result<OccupancyGrid, GridError>> {
        let width = usize::try_from(self.width).ok().filter(|width| *width > 0)?;
        let cells: Vec<Cell> = (0..self.cells.len()).map(|index| self.cell(index)).collect();
        let is_known = |cell: &Cell| *cell != Cell::Unknown;
        let rows: Vec<&[Cell]> = cells.chunks_exact(width).collect();
        let bottom = rows.iter().position(|row| row.iter().any(is_known))?.saturating_sub(1);
        let top = (rows.iter().rposition(|row| row.iter().any(is_known))? + 2).min(rows.len());
        let left = rows.iter().filter_map(|row| row.iter().position(is_known)).min()?.saturating_sub(1);
        let right = (rows.iter().filter_map(|row| row.iter().rposition(is_known)).max()? + 2).min(width);
        let cropped = rows[bottom..top].iter().flat_map(|row| row[left..right].iter().copied()).collect();
        let position = |first: i64, skipped: usize| (first as f64 + skipped as f64) * self.resolution;
        let origin = Pose2::new(position(self.first[0], left), position(self.first[1], bottom), 0.0);
        Some(OccupancyGrid::new(right - left, self.resolution, origin, cropped))
    }

    /// Hit and pass counts at a point.
    pub fn evidence(&self, point: &Point) -> Evidence {
        self.cells.get(self.index(self.column_and_row(point))).copied().unwrap_or_default()
    }

    /// State of the cell at a point.
    pub fn cell_at(&self, point: &Point) -> Cell {
        self.cell(self.index(self.column_and_row(point)))
    }

    /// State of a cell, by its index.
    fn cell(&self, index: usize) -> Cell {
        let Some(evidence) = self.cells.get(index) else { return Cell::Unknown };
        let width = usize::try_from(self.width).unwrap_or_default();
        let rows = [index.wrapping_sub(width), index, index.wrapping_add(width)];
        let around = rows.into_iter().flat_map(|middle| [middle.wrapping_sub(1), middle, middle.wrapping_add(1)]);
        evidence.classify(around.filter(|&other| other != index).filter_map(|other| self.cells.get(other)).copied())
    }
}

/// Direction into the surface hit by ray `i`: along the normal, if the neighbouring rays hit the same surface, else along the ray.
fn into_surface(ends: &[Point], i: usize, direction: &Point) -> Point {
    let neighbours = i.checked_sub(1).and_then(|before| ends.get(before)).zip(ends.get(i + 1));
    let Some((before, after)) = neighbours else { return *direction };
    let along = after - before;
    let length = along.norm();
    let deviation = along.perp(&(ends[i] - before)).abs() / length;
    let normal = perpendicular(along) / length;
    let facing = normal.dot(direction);
    // A neighbour without a return is NaN, and comparisons with NaN are false.
    if length > 0.0 && deviation < MAX_LINE_DEVIATION && facing != 0.0 { normal * facing.signum() } else { *direction }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// End points on the wall `x = 2.01`, seen from a laser with 181 rays to the front.
    fn wall(laser: &Point) -> Vec<[f32; 2]> {
        let angles = (-90..=90).map(|i| f64::from(i).to_radians());
        angles
            .map(|angle| {
                let range = (2.01 - laser.x) / angle.cos();
                if range < 30.0 { [(range * angle.cos()) as f32, (range * angle.sin()) as f32] } else { [f32::NAN; 2] }
            })
            .collect()
    }

    fn drive_past_wall(steps: usize) -> EvidenceGrid {
        let mut grid = EvidenceGrid::new(0.05);
        for i in 0..steps {
            let laser = Point::new(0.0, 0.1 * i as f64);
            grid.insert(&wall(&laser), &Pose2::new(laser.x, laser.y, 0.0));
        }
        grid
    }

    #[test]
    fn a_wall_is_one_cell_thick_without_holes_and_with_free_space_in_front() {
        let grid = drive_past_wall(40);
        for i in 0..40 {
            let y = 0.05 + 0.1 * f64::from(i);
            let cell = |x: f64| grid.cell_at(&Point::new(x, y));
            assert_eq!(cell(2.02), Cell::Occupied, "{y}");
            assert_eq!([0.5, 1.0, 1.9].map(cell), [Cell::Free; 3], "{y}");
            assert_eq!(cell(2.12), Cell::Unknown, "{y}");
        }
        let map = grid.to_map().unwrap().unwrap();
        let known = map.cells().iter().filter(|cell| **cell != Cell::Unknown).count();
        assert!(known > 1000 && map.width() < 60, "{known} {}", map.width());
        let first = map.coordinates(Point::new(2.02, 1.0));
        assert_eq!(map.cell(first.x as i64, first.y as i64), Some(Cell::Occupied));
    }

    /// The sides of a corridor, at y = 1.04 and -1.04, seen from at least 10 m away: at less than six degrees.
    #[test]
    fn a_wall_hit_by_grazing_rays_has_no_holes() {
        let mut grid = EvidenceGrid::new(0.05);
        for step in 0..80 {
            let laser = Point::new(0.05 * f64::from(step), 0.002 * f64::from(step % 40) - 0.04);
            let end = |i: i32| {
                let angle = (0.25 * f64::from(i)).to_radians();
                let side = ((1.04 * angle.sin().signum() - laser.y) / angle.sin()).abs();
                let range = side.min((20.0 - laser.x) / angle.cos()) + 0.02 * f64::from(i * 7 + step * 3).sin();
                [(range * angle.cos()) as f32, (range * angle.sin()) as f32]
            };
            grid.insert(&(-160..=160).map(end).collect::<Vec<_>>(), &Pose2::new(laser.x, laser.y, 0.0));
        }
        // Few rays reach so far, and some cells get none.
        let points = || (0..100).flat_map(|i| [-1.0, 1.0].map(|side| (14.025 + 0.05 * f64::from(i), side)));
        let count = |y: f64, kind: Cell| points().filter(|(x, side)| grid.cell_at(&Point::new(*x, side * y)) == kind).count();
        assert!(count(1.07, Cell::Occupied) > 160 && count(1.07, Cell::Free) == 0, "{}", count(1.07, Cell::Occupied));
        assert_eq!(count(0.97, Cell::Free), 200);
    }

    #[test]
    fn people_who_walked_by_vanish() {
        let mut grid = EvidenceGrid::new(0.05);
        let laser = Point::zeros();
        let mut with_person = wall(&laser);
        for (i, point) in with_person.iter_mut().enumerate().skip(85).take(10) {
            let angle = (i as f64 - 90.0).to_radians();
            *point = [angle.cos() as f32, angle.sin() as f32];
        }
        let person = Point::new(1.02, 0.0);
        for _ in 0..4 {
            grid.insert(&with_person, &Pose2::IDENTITY);
        }
        assert_eq!(grid.cell_at(&person), Cell::Occupied);
        for _ in 0..20 {
            grid.insert(&wall(&laser), &Pose2::IDENTITY);
        }
        assert_eq!(grid.cell_at(&person), Cell::Free);
    }

    #[test]
    fn sparse_hits_make_a_wall_but_noise_behind_one_does_not() {
        let hits = |hits: u32| Evidence { hits, passes: 0 };
        let beside = |own: u32, around: &[u32]| hits(own).classify(around.iter().map(|&count| hits(count)));
        assert_eq!(beside(1, &[1, 1]), Cell::Occupied);
        assert_eq!(beside(1, &[1]), Cell::Unknown);
        assert_eq!(beside(2, &[50, 50]), Cell::Unknown);
        assert_eq!(beside(3, &[50]), Cell::Occupied);
    }

    #[test]
    fn rays_without_a_return_are_ignored() {
        let mut grid = EvidenceGrid::new(0.05);
        grid.insert(&[[f32::NAN; 2]; 10], &Pose2::IDENTITY);
        assert!(grid.to_map().is_none());
        grid.insert(&[[f32::INFINITY, 1.0]], &Pose2::new(1e300, 0.0, 0.0));
        assert!(grid.to_map().is_none(), "diverged poses are ignored, too");
    }

    #[test]
    fn removing_a_scan_restores_the_grid() {
        let mut grid = drive_past_wall(3);
        let before: Vec<Evidence> = grid.cells.iter().copied().filter(|cell| *cell != Evidence::default()).collect();
        let pose = Pose2::new(3.0, 7.0, 0.4);
        grid.insert(&wall(&Point::zeros()), &pose);
        grid.remove(&wall(&Point::zeros()), &pose);
        let after: Vec<Evidence> = grid.cells.iter().copied().filter(|cell| *cell != Evidence::default()).collect();
        assert_eq!(before, after);
    }

    #[test]
    fn the_map_does_not_depend_on_the_order_of_scans() {
        let points = wall(&Point::zeros());
        let poses = [Pose2::new(3.0, 7.0, 0.4), Pose2::new(-40.0, 2.0, 2.0), Pose2::new(0.3, -30.0, -1.0)];
        let draw = |order: [usize; 3]| {
            let mut grid = EvidenceGrid::new(0.05);
            for i in order {
                (0..3).for_each(|_| grid.insert(&points, &poses[i]));
            }
            grid.to_map().unwrap().unwrap()
        };
        assert_eq!(draw([0, 1, 2]), draw([2, 0, 1]));
    }
}
