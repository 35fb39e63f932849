//! What stands where, by where rays end and what they pass.
//!
//! A cell counts the rays that end in it and those that pass it. Where more than a quarter of a cell's rays end, and three in all, something
//! stands; who has walked by is passed by later rays, and gone. Far off rays are sparse: there three in the cell and those around it do, where
//! it does not stand back behind them. Two things keep walls whole (figures in docs/maps.md):
//! - What a ray meets begins where it ends: a hit counts in the cell half a cell farther into the surface, at right angles to it. Along the ray
//!   it would not get in where the ray grazes the wall.
//! - A ray passes the cells whose middle it passes, not those whose corner it clips, and only as long as it is half a cell away from the
//!   surface that it meets: such cells are before it.
//!
//! A ray that met nothing has no end, and says nothing here: glass, dark surfaces and a free view look alike to it.

use crate::geometry::{Point, Pose2, perpendicular};
use crate::map::grid::{Cell, GridError, OccupancyGrid};

/// Fewest rays that must end in a cell for something to stand there.
const FEWEST_HITS: u32 = 3;
/// For each ray that ends in a cell fewer than so many may pass it.
const PASSES_PER_HIT: u32 = 3;
/// A cell with fewer has not so many times less than one beside it: else its rays are that one's, with their noise.
const STANDING_BACK: u32 = 2;
/// Fewest rays that must pass a cell for it to be free: single ones are fans through gaps and windows.
const FEWEST_PASSES: u32 = 2;
/// Three neighbouring rays that end on a line to within this, m, see one surface.
const STRAIGHT: f64 = 0.05;
/// When the grid must grow, it does so by so many cells more, ...
const GROWTH: i64 = 128;
/// ... and by this part of its side, so that it grows seldom.
const GROWTH_PART: i64 = 4;
/// Most cells, so that a wild pose is no end of memory: 4 km^2 at 5 cm.
const MOST_CELLS: i64 = 1 << 31;

/// Rows along a ray are counted in parts of a cell, so many bits of them.
const FRACTION_BITS: u32 = 24;
const FRACTION: f64 = (1_u32 << FRACTION_BITS) as f64;

/// Where the rays of a scan end, in the laser's frame and in the order of the rays, m; NaN where a ray has no end.
pub(super) type EndPoints = [[f32; 2]];

/// Rays that ended in a cell and that passed it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evidence {
    /// Ended.
    pub hits: u32,
    /// Passed.
    pub passes: u32,
}

impl Evidence {
    /// What stands there, beside what is counted in the cells around.
    fn cell(self, around: impl Iterator<Item = Self>) -> Cell {
        let Self { hits, passes } = self;
        if hits == 0 || PASSES_PER_HIT.saturating_mul(hits) <= passes {
            return if passes >= FEWEST_PASSES { Cell::Free } else { Cell::Unknown };
        }
        let (mut sum, mut most) = (hits, 0);
        if hits < FEWEST_HITS {
            around.for_each(|other| (sum, most) = (sum.saturating_add(other.hits), most.max(other.hits)));
        }
        if sum >= FEWEST_HITS && STANDING_BACK * hits >= most { Cell::Occupied } else { Cell::Unknown }
    }
}

/// The counts of all cells; grows with what is drawn.
#[derive(Clone, Debug)]
pub struct EvidenceGrid {
    resolution: f64,
    /// Column and row of the first cell, in cells from the map's origin.
    first: [i64; 2],
    width: i64,
    height: i64,
    cells: Vec<Evidence>,
}

impl EvidenceGrid {
    /// An empty grid; `resolution` is the side of a cell, m. Cells begin at multiples of it, so that two maps of one place have the same.
    pub fn new(resolution: f64) -> Self {
        Self { resolution, first: [0, 0], width: 0, height: 0, cells: Vec::new() }
    }

    /// Draws a scan that was taken at a pose of the laser.
    pub(super) fn draw(&mut self, points: &EndPoints, map_from_laser: &Pose2) {
        self.count(points, map_from_laser, |count| count.saturating_add(1));
    }

    /// Takes back what [`Self::draw`] has drawn of a scan at a pose.
    pub(super) fn erase(&mut self, points: &EndPoints, map_from_laser: &Pose2) {
        self.count(points, map_from_laser, |count| count.saturating_sub(1));
    }

    /// Changes the counts of all cells that the rays of a scan end in or pass.
    fn count(&mut self, points: &EndPoints, map_from_laser: &Pose2, change: impl Fn(u32) -> u32) {
        let transform = map_from_laser.transform();
        let ends: Vec<Point> = points.iter().map(|&[x, y]| transform.apply(Point::new(x.into(), y.into()))).collect();
        let laser = map_from_laser.translation();
        if !self.make_room(std::iter::once(&laser).chain(&ends)) {
            return;
        }
        for (i, end) in ends.iter().enumerate() {
            let way = end - laser;
            let range = way.norm();
            if !(range.is_finite() && range > 0.0) {
                continue;
            }
            let direction = way / range;
            let into = into_surface(&ends, i, &direction);
            let half = 0.5 * self.resolution;
            let hit = self.index(self.column_and_row(&(end + into * half)));
            self.pass(&laser, &direction, range - half / into.dot(&direction), hit, &change);
            if let Some(cell) = self.cells.get_mut(hit) {
                cell.hits = change(cell.hits);
            }
        }
    }

    /// Counts a ray in the cells that it passes on the first `length` metres, but not in the one that it hits: in each column (or row, if that
    /// is more along the ray) the one whose centre is nearest to it (Bresenham 1965). Of a cell whose corner it clips it says little.
    #[allow(clippy::cast_possible_truncation)] // saturates
    fn pass(&mut self, from: &Point, direction: &Point, length: f64, hit: usize, change: &impl Fn(u32) -> u32) {
        let along = usize::from(direction.x.abs() < direction.y.abs());
        let across = 1 - along;
        let strides = [1, self.width];
        let first = self.first.map(|cell| cell as f64);
        let centre = |axis: usize, place: f64| place / self.resolution - first[axis] - 0.5;
        let (start, end) = (centre(along, from[along]), centre(along, from[along] + direction[along] * length));
        let forwards = direction[along] > 0.0;
        let (column, last) = if forwards { (start.ceil(), end.floor()) } else { (start.floor(), end.ceil()) };
        let slope = direction[across] / direction[along].abs();
        let row = centre(across, from[across]) + 0.5 + (column - start).abs() * slope;
        let (mut row, step) = ((row * FRACTION) as i64, (slope * FRACTION) as i64);
        let mut place = column as i64 * strides[along];
        let stride = if forwards { strides[along] } else { -strides[along] };
        let columns = if forwards { last - column } else { column - last };
        for _ in 0..=columns as i64 {
            let index = usize::try_from(place + (row >> FRACTION_BITS) * strides[across]).unwrap_or(usize::MAX);
            if index != hit
                && let Some(cell) = self.cells.get_mut(index)
            {
                cell.passes = change(cell.passes);
            }
            (place, row) = (place + stride, row + step);
        }
    }

    /// The cell of a point, from the map's origin.
    #[allow(clippy::cast_possible_truncation)] // saturates
    fn column_and_row(&self, point: &Point) -> [i64; 2] {
        [(point.x / self.resolution).floor() as i64, (point.y / self.resolution).floor() as i64]
    }

    /// Its place in `cells`; past the end where it is outside.
    fn index(&self, [column, row]: [i64; 2]) -> usize {
        let (x, y) = (column - self.first[0], row - self.first[1]);
        let is_inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        if is_inside { usize::try_from(y * self.width + x).unwrap_or(usize::MAX) } else { usize::MAX }
    }

    /// Grows so that all points are inside, each with a cell around it; answers whether they are.
    fn make_room<'a>(&mut self, points: impl Iterator<Item = &'a Point>) -> bool {
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        for point in points.filter(|point| point.x.is_finite() && point.y.is_finite()) {
            for (i, place) in self.column_and_row(point).into_iter().enumerate() {
                low[i] = low[i].min(place.saturating_sub(1));
                high[i] = high[i].max(place.saturating_add(1));
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
        let growth = size.map(|side| GROWTH + side / GROWTH_PART);
        let first = [0, 1].map(|i| if low[i] < self.first[i] { low[i].saturating_sub(growth[i]) } else { self.first[i] });
        let end = [0, 1].map(|i| {
            let end = self.first[i] + size[i];
            if high[i] >= end { high[i].saturating_add(growth[i]) } else { end }
        });
        let (width, height) = (end[0].saturating_sub(first[0]), end[1].saturating_sub(first[1]));
        if width.saturating_mul(height) > MOST_CELLS {
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

    /// The map: what is known, and a cell around it. `None` where nothing is.
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
        let place = |first: i64, skipped: usize| (first as f64 + skipped as f64) * self.resolution;
        let origin = Pose2::new(place(self.first[0], left), place(self.first[1], bottom), 0.0);
        Some(OccupancyGrid::new(right - left, self.resolution, origin, cropped))
    }

    /// What is counted in the cell of a point.
    pub fn evidence(&self, point: &Point) -> Evidence {
        self.cells.get(self.index(self.column_and_row(point))).copied().unwrap_or_default()
    }

    /// What stands at a point.
    pub fn cell_at(&self, point: &Point) -> Cell {
        self.cell(self.index(self.column_and_row(point)))
    }

    /// What stands in a cell, by its place.
    fn cell(&self, index: usize) -> Cell {
        let Some(evidence) = self.cells.get(index) else { return Cell::Unknown };
        let width = usize::try_from(self.width).unwrap_or_default();
        let rows = [index.wrapping_sub(width), index, index.wrapping_add(width)];
        let around = rows.into_iter().flat_map(|place| [place.wrapping_sub(1), place, place.wrapping_add(1)]);
        evidence.cell(around.filter(|&place| place != index).filter_map(|place| self.cells.get(place)).copied())
    }
}

/// The direction at right angles into the surface that ray `i` meets, where its neighbours show that; else that of the ray.
fn into_surface(ends: &[Point], i: usize, direction: &Point) -> Point {
    let neighbours = i.checked_sub(1).and_then(|before| ends.get(before)).zip(ends.get(i + 1));
    let Some((before, after)) = neighbours else { return *direction };
    let along = after - before;
    let length = along.norm();
    let off = along.perp(&(ends[i] - before)).abs() / length;
    let normal = perpendicular(along) / length;
    let facing = normal.dot(direction);
    // A comparison with NaN, of a neighbour without an end, is false.
    if length > 0.0 && off < STRAIGHT && facing != 0.0 { normal * facing.signum() } else { *direction }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a laser sees of the wall `x = 2.01` from its place, in 181 rays to the front.
    fn wall(laser: &Point) -> Vec<[f32; 2]> {
        let angles = (-90..=90).map(|i| f64::from(i).to_radians());
        angles
            .map(|angle| {
                let range = (2.01 - laser.x) / angle.cos();
                if range < 30.0 { [(range * angle.cos()) as f32, (range * angle.sin()) as f32] } else { [f32::NAN; 2] }
            })
            .collect()
    }

    fn passing_by(steps: usize) -> EvidenceGrid {
        let mut grid = EvidenceGrid::new(0.05);
        for i in 0..steps {
            let laser = Point::new(0.0, 0.1 * i as f64);
            grid.draw(&wall(&laser), &Pose2::new(laser.x, laser.y, 0.0));
        }
        grid
    }

    #[test]
    fn a_wall_is_one_cell_thick_whole_and_free_before() {
        let grid = passing_by(40);
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

    /// A corridor's sides, at y = 1.04 and -1.04, seen from 10 m before its end and farther: at less than six degrees.
    #[test]
    fn a_wall_that_is_only_grazed_is_whole() {
        let mut grid = EvidenceGrid::new(0.05);
        for step in 0..80 {
            let laser = Point::new(0.05 * f64::from(step), 0.002 * f64::from(step % 40) - 0.04);
            let end = |i: i32| {
                let angle = (0.25 * f64::from(i)).to_radians();
                let side = ((1.04 * angle.sin().signum() - laser.y) / angle.sin()).abs();
                let range = side.min((20.0 - laser.x) / angle.cos()) + 0.02 * f64::from(i * 7 + step * 3).sin();
                [(range * angle.cos()) as f32, (range * angle.sin()) as f32]
            };
            grid.draw(&(-160..=160).map(end).collect::<Vec<_>>(), &Pose2::new(laser.x, laser.y, 0.0));
        }
        // Few rays get so far: some cells have none.
        let places = || (0..100).flat_map(|i| [-1.0, 1.0].map(|side| (14.025 + 0.05 * f64::from(i), side)));
        let share = |y: f64, kind: Cell| places().filter(|(x, side)| grid.cell_at(&Point::new(*x, side * y)) == kind).count();
        assert!(share(1.07, Cell::Occupied) > 160 && share(1.07, Cell::Free) == 0, "{}", share(1.07, Cell::Occupied));
        assert_eq!(share(0.97, Cell::Free), 200);
    }

    #[test]
    fn who_has_walked_by_is_gone() {
        let mut grid = EvidenceGrid::new(0.05);
        let laser = Point::zeros();
        let mut with_somebody = wall(&laser);
        for (i, point) in with_somebody.iter_mut().enumerate().skip(85).take(10) {
            let angle = (i as f64 - 90.0).to_radians();
            *point = [angle.cos() as f32, angle.sin() as f32];
        }
        let somebody = Point::new(1.02, 0.0);
        for _ in 0..4 {
            grid.draw(&with_somebody, &Pose2::IDENTITY);
        }
        assert_eq!(grid.cell_at(&somebody), Cell::Occupied);
        for _ in 0..20 {
            grid.draw(&wall(&laser), &Pose2::IDENTITY);
        }
        assert_eq!(grid.cell_at(&somebody), Cell::Free);
    }

    #[test]
    fn sparse_rays_make_a_wall_and_noise_behind_one_does_not() {
        let hits = |hits: u32| Evidence { hits, passes: 0 };
        let beside = |own: u32, around: &[u32]| hits(own).cell(around.iter().map(|&count| hits(count)));
        assert_eq!(beside(1, &[1, 1]), Cell::Occupied);
        assert_eq!(beside(1, &[1]), Cell::Unknown);
        assert_eq!(beside(2, &[50, 50]), Cell::Unknown);
        assert_eq!(beside(3, &[50]), Cell::Occupied);
    }

    #[test]
    fn rays_without_an_end_say_nothing() {
        let mut grid = EvidenceGrid::new(0.05);
        grid.draw(&[[f32::NAN; 2]; 10], &Pose2::IDENTITY);
        assert!(grid.to_map().is_none());
        grid.draw(&[[f32::INFINITY, 1.0]], &Pose2::new(1e300, 0.0, 0.0));
        assert!(grid.to_map().is_none(), "nor do poses from nowhere");
    }

    #[test]
    fn what_is_erased_was_never_there() {
        let mut grid = passing_by(3);
        let before: Vec<Evidence> = grid.cells.iter().copied().filter(|cell| *cell != Evidence::default()).collect();
        let pose = Pose2::new(3.0, 7.0, 0.4);
        grid.draw(&wall(&Point::zeros()), &pose);
        grid.erase(&wall(&Point::zeros()), &pose);
        let after: Vec<Evidence> = grid.cells.iter().copied().filter(|cell| *cell != Evidence::default()).collect();
        assert_eq!(before, after);
    }

    #[test]
    fn it_does_not_matter_where_the_grid_began() {
        let points = wall(&Point::zeros());
        let poses = [Pose2::new(3.0, 7.0, 0.4), Pose2::new(-40.0, 2.0, 2.0), Pose2::new(0.3, -30.0, -1.0)];
        let draw = |order: [usize; 3]| {
            let mut grid = EvidenceGrid::new(0.05);
            for i in order {
                (0..3).for_each(|_| grid.draw(&points, &poses[i]));
            }
            grid.to_map().unwrap().unwrap()
        };
        assert_eq!(draw([0, 1, 2]), draw([2, 0, 1]));
    }
}
