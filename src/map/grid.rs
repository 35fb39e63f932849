//! Occupancy grids with exact ray casting.

use thiserror::Error;

use crate::geometry::{Point, Pose2, RigidTransform};

/// State of a map cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Free space.
    Free,
    /// A wall or another obstacle.
    Occupied,
    /// Not observed. Rays pass through, but a vehicle must not enter.
    Unknown,
}

/// Why a grid is invalid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GridError {
    /// The resolution is not a positive number.
    #[error("resolution is {0}: it must be a positive number of metres per cell")]
    Resolution(f64),
    /// The pose of the lower left corner is not finite.
    #[error("origin is {0:?}: x, y and yaw must be finite")]
    Origin(Pose2),
    /// The number of cells is not width times height, or it is zero.
    #[error("{cells} cells do not make {width} x {height}")]
    Size {
        /// Number of columns.
        width: usize,
        /// Number of rows.
        height: usize,
        /// Number of cells.
        cells: usize,
    },
}

/// A map of square cells.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    width: usize,
    height: usize,
    resolution: f64,
    origin: Pose2,
    map_from_grid: RigidTransform,
    grid_from_map: RigidTransform,
    cells: Vec<Cell>,
}

impl OccupancyGrid {
    /// Creates a grid of `width` columns, with rows from the bottom up. `origin` is the pose of the lower left corner of the first cell
    /// in the map frame; `resolution` is the side length of a cell, m.
    pub fn new(width: usize, resolution: f64, origin: Pose2, cells: Vec<Cell>) -> Result<Self, GridError> {
        let height = cells.len().checked_div(width).unwrap_or(0);
        if height == 0 || width * height != cells.len() {
            return Err(GridError::Size { width, height, cells: cells.len() });
        }
        if !(resolution.is_finite() && resolution > 0.0) {
            return Err(GridError::Resolution(resolution));
        }
        if !origin.is_finite() {
            return Err(GridError::Origin(origin));
        }
        let (map_from_grid, grid_from_map) = (origin.transform(), origin.inverse().transform());
        Ok(Self { width, height, resolution, origin, map_from_grid, grid_from_map, cells })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Side length of a cell, m.
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Pose of the lower left corner of the first cell in the map frame.
    pub fn origin(&self) -> Pose2 {
        self.origin
    }

    /// The cell at a column and row; `None` outside the map.
    pub fn cell(&self, column: i64, row: i64) -> Option<Cell> {
        let (column, row) = (usize::try_from(column).ok()?, usize::try_from(row).ok()?);
        (column < self.width && row < self.height).then(|| self.cells[row * self.width + column])
    }

    /// All cells, row by row from the bottom up.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The centre of a cell in the map frame.
    pub fn centre(&self, column: usize, row: usize) -> Point {
        self.map_from_grid.apply(Point::new(column as f64 + 0.5, row as f64 + 0.5) * self.resolution)
    }

    /// The centres of all cells of a kind in the map frame.
    pub fn centres(&self, kind: Cell) -> Vec<Point> {
        let cells = self.cells.iter().enumerate().filter(|(_, cell)| **cell == kind);
        cells.map(|(index, _)| self.centre(index % self.width, index / self.width)).collect()
    }

    /// Whether each cell is occupied, in a grid with `margin` more cells on every side, which are not; and the width of that grid.
    pub fn padded_walls(&self, margin: usize) -> (Vec<bool>, usize) {
        let width = self.width + 2 * margin;
        let mut walls = vec![false; width * (self.height + 2 * margin)];
        for (row, cells) in walls.chunks_exact_mut(width).skip(margin).zip(self.cells.chunks_exact(self.width)) {
            for (is_wall, cell) in row[margin..].iter_mut().zip(cells) {
                *is_wall = *cell == Cell::Occupied;
            }
        }
        (walls, width)
    }

    /// Converts a point from the map frame to fractional column and row.
    pub fn coordinates(&self, point: Point) -> Point {
        self.grid_from_map.apply(point) / self.resolution
    }

    /// Converts a pose from the map frame to the grid: fractional column and row, and the heading relative to the direction of the rows.
    pub fn pose_in_cells(&self, map_pose: &Pose2) -> Pose2 {
        let cell = self.coordinates(map_pose.translation());
        Pose2::new(cell.x, cell.y, map_pose.theta - self.origin.theta)
    }

    /// Converts a pose from the grid to the map frame: the inverse of [`Self::pose_in_cells`].
    pub fn pose_in_map(&self, pose: &Pose2) -> Pose2 {
        self.origin * Pose2::new(pose.x * self.resolution, pose.y * self.resolution, pose.theta)
    }

    /// Casts a ray from `origin` along the unit vector `direction`: distance to the first occupied cell, m. `None` if there is none
    /// within `max` and within the map, or if the ray starts outside the map. Every cell along the ray is checked (Amanatides and Woo,
    /// 1987).
    pub fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64> {
        let start = self.coordinates(origin);
        let direction = self.grid_from_map.rotate(direction);
        let mut x = Traversal::new(start.x, direction.x);
        let mut y = Traversal::new(start.y, direction.y);
        let max_length = max / self.resolution;
        let mut travelled = 0.0;
        while travelled <= max_length {
            if self.cell(x.cell, y.cell)? == Cell::Occupied {
                return Some(travelled * self.resolution);
            }
            travelled = if x.next < y.next { x.advance() } else { y.advance() };
        }
        None
    }
}

/// Traversal of the grid along one axis; lengths are along the ray, in cells.
struct Traversal {
    cell: i64,
    step: i64,
    /// Length at which the ray enters the next cell.
    next: f64,
    /// Length between two boundaries.
    stride: f64,
}

impl Traversal {
    #[allow(clippy::cast_possible_truncation)] // saturates: far outside any map
    fn new(start: f64, direction: f64) -> Self {
        let cell = start.floor();
        let forward = direction > 0.0;
        let boundary = if forward { cell + 1.0 } else { cell };
        let next = if direction == 0.0 { f64::INFINITY } else { (boundary - start) / direction };
        Self { cell: cell as i64, step: if forward { 1 } else { -1 }, next, stride: direction.abs().recip() }
    }

    /// Enters the next cell; returns the length at its boundary.
    fn advance(&mut self) -> f64 {
        let entered = self.next;
        self.cell = self.cell.saturating_add(self.step);
        self.next += self.stride;
        entered
    }
}
