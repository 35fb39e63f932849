//! What stands where, by where rays end and what they pass.
//!
//! A cell counts the rays that end in it and those that pass it. Where more than a quarter of a cell's rays end, and three in all, something
//! stands; who has walked by is passed by later rays, and gone. Far off rays are sparse: there three in the cell and those around it do, where
//! it does not stand back behind them. Two things keep walls whole (figures in docs/maps.md):
//! - What a ray meets begins where it ends: the cell of a hit is that half a cell farther out.
//! - A ray that grazes a wall runs along in the cells of the wall's surface. It passes cells only as long as it is a cell away from the
//!   surface, measured across the surface.
//!
//! A ray that met nothing has no end, and says nothing here: glass, dark surfaces and a free view look alike to it.

use crate::geometry::{Point, Pose2};
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
            let margin = self.resolution / facing(&ends, i, &direction);
            let hit = self.index(self.column_and_row(&(end + direction * (0.5 * self.resolution))));
            self.pass(&laser, &direction, range - margin, hit, &change);
            if let Some(cell) = self.cells.get_mut(hit) {
                cell.hits = change(cell.hits);
            }
        }
    }

    /// Counts a ray in the cells that it passes on the first `length` metres (Amanatides and Woo 1987), but not in the one that it hits.
    fn pass(&mut self, from: &Point, direction: &Point, length: f64, hit: usize, change: &impl Fn(u32) -> u32) {
        if length <= 0.0 {
            return;
        }
        let (start, reach) = (from / self.resolution, length / self.resolution);
        let cell = self.column_and_row(from);
        let mut index = self.index(cell);
        let axis = |i: usize, stride: i64| {
            let rate = direction[i].abs().recip();
            let to_next = if direction[i] > 0.0 { start[i].floor() + 1.0 - start[i] } else { start[i] - start[i].floor() };
            let next = if direction[i] == 0.0 { f64::INFINITY } else { to_next * rate };
            (next, rate, if direction[i] > 0.0 { stride } else { -stride })
        };
        let ((mut next_x, rate_x, step_x), (mut next_y, rate_y, step_y)) = (axis(0, 1), axis(1, self.width));
        loop {
            if index != hit
                && let Some(cell) = self.cells.get_mut(index)
            {
                cell.passes = change(cell.passes);
            }
            let step = if next_x < next_y {
                if next_x > reach {
                    return;
                }
                next_x += rate_x;
                step_x
            } else {
                if next_y > reach {
                    return;
                }
                next_y += rate_y;
                step_y
            };
            index = index.wrapping_add_signed(isize::try_from(step).unwrap_or_default());
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

/// Cosine of the angle at which ray `i` meets its surface, where its neighbours show that; else 1.
fn facing(ends: &[Point], i: usize, direction: &Point) -> f64 {
    let neighbours = i.checked_sub(1).and_then(|before| ends.get(before)).zip(ends.get(i + 1));
    let Some((before, after)) = neighbours else { return 1.0 };
    let along = after - before;
    let length = along.norm();
    let off = along.perp(&(ends[i] - before)).abs() / length;
    // A comparison with NaN, of a neighbour without an end, is false.
    if length > 0.0 && off < STRAIGHT { (along.perp(direction).abs() / length).max(f64::EPSILON) } else { 1.0 }
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
