//! Occupancy grids as worlds.

use crate::geometry::Point;
use crate::map::distance::DistanceField;
use crate::map::grid::{Cell, OccupancyGrid};

use super::world::World;

/// A map as a world: the grid with the clearance of every cell.
#[derive(Clone, Debug)]
pub struct GridWorld {
    grid: OccupancyGrid,
    clearance: DistanceField,
}

impl GridWorld {
    /// Computes the clearances, for which unknown cells count as walls.
    pub fn new(grid: OccupancyGrid) -> Self {
        let clearance = DistanceField::new(grid.width(), grid.cells().iter().map(|&cell| cell != Cell::Free));
        Self { grid, clearance }
    }

    /// The map.
    pub fn grid(&self) -> &OccupancyGrid {
        &self.grid
    }
}

impl World for GridWorld {
    fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64> {
        self.grid.range(origin, direction, max)
    }

    #[allow(clippy::cast_possible_truncation)] // saturates far outside of any map
    fn clearance(&self, point: Point) -> f64 {
        let cell = self.grid.coordinates(point);
        let distance = self.clearance.at(cell.x.floor() as i64, cell.y.floor() as i64);
        // The distance field is between cell centres; the point and the wall may each be half a diagonal closer.
        (distance - std::f64::consts::SQRT_2).max(0.0) * self.grid.resolution()
    }
}
