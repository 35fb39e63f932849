//! Bresenham's line algorithm, modified to visit every cell that the ray touches, from any start within a cell.

use super::bits::WallBits;
use super::{Fan, RayCaster, Viewpoint};
use crate::map::grid::OccupancyGrid;

/// Resolution of positions, units per cell.
const SUBCELLS: f32 = 4096.0;
/// Resolution of the components of directions, units per 1.
const UNIT: f32 = 1_048_576.0;

/// Traverses the grid cell by cell.
pub(super) struct Bresenham {
    walls: WallBits,
    max_range: f32,
}

impl Bresenham {
    pub(super) fn new(grid: &OccupancyGrid, max_range: f32) -> Self {
        Self { walls: WallBits::new(grid), max_range }
    }

    fn length(&self, start: usize, from: &Viewpoint, direction: [f32; 2]) -> f32 {
        let (mut x, mut y) = (Axis::new(from.x, direction[0], 1), Axis::new(from.y, direction[1], self.walls.stride()));
        let mut index = start;
        // Its sign indicates which boundary is nearer; both sides are multiplied by the components to avoid a division.
        let mut error = x.first * y.speed - y.first * x.speed;
        let (step_x, step_y) = (y.speed * SUBCELLS as i64, x.speed * SUBCELLS as i64);
        let mut last_step_is_in_x = true;
        let max_steps = (self.max_range * (direction[0].abs() + direction[1].abs())) as usize + 2;
        for _ in 0..max_steps {
            if self.walls.stops(index) {
                if index == start {
                    return 0.0;
                }
                let length = if last_step_is_in_x { x.length() } else { y.length() };
                return if self.walls.is_border(index) || length > self.max_range { f32::INFINITY } else { length };
            }
            if error == 0 && self.walls.stops(index.wrapping_add(y.stride)) {
                // Through a corner the ray touches both neighbours.
                last_step_is_in_x = false;
                index = index.wrapping_add(y.advance());
                error -= step_y;
                continue;
            }
            last_step_is_in_x = error <= 0;
            if last_step_is_in_x {
                index = index.wrapping_add(x.advance());
                error += step_x;
            } else {
                index = index.wrapping_add(y.advance());
                error -= step_y;
            }
        }
        f32::INFINITY
    }
}

/// Traversal along one axis.
struct Axis {
    /// Distance to the first boundary, subcells.
    first: i64,
    /// Magnitude of the component of the direction.
    speed: i64,
    /// What a step adds to the index of the cell; wraps around for negative directions.
    stride: usize,
    steps: i64,
}

impl Axis {
    fn new(start: f32, direction: f32, stride: usize) -> Self {
        let within = ((start - start.floor()) * SUBCELLS) as i64;
        let forward = direction > 0.0;
        Self {
            first: if forward { SUBCELLS as i64 - within } else { within },
            speed: (direction.abs() * UNIT).round() as i64,
            stride: if forward { stride } else { stride.wrapping_neg() },
            steps: 0,
        }
    }

    fn advance(&mut self) -> usize {
        self.steps += 1;
        self.stride
    }

    /// Length of the ray up to the boundary crossed last, cells.
    fn length(&self) -> f32 {
        ((self.steps - 1) as f32 + self.first as f32 / SUBCELLS) * UNIT / self.speed as f32
    }
}

impl RayCaster for Bresenham {
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]) {
        fan.fill(from, lengths, |from, beam| {
            let start = self.walls.index(from.x, from.y);
            start.map_or(f32::INFINITY, |start| self.length(start, from, beam.direction_from(from)))
        });
    }

    fn memory(&self) -> usize {
        self.walls.memory()
    }
}
