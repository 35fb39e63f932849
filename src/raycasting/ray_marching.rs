//! Exact ray marching on a distance transform: leaps that cannot cross a wall, and cell by cell near walls.

use super::{Fan, RayCaster, Viewpoint};
use crate::map::distance::DistanceField;
use crate::map::grid::{Cell, OccupancyGrid};

/// Leaps are rounded down to multiples of this, cells.
const LEAP_UNIT: f32 = 0.5;
/// Extra length when the ray enters a cell, cells, so that rounding does not keep it outside.
const INTO_CELL: f32 = 1e-3;
/// Entry of a wall, which ends the march.
const WALL: u8 = 0;
/// Entry of a cell near a wall: march only to its boundary.
const NEAR: u8 = 1;
/// Entry of the border around the map, where a march ends without a hit.
const BORDER: u8 = u8::MAX;

/// Lengths of the leaps from every cell, with a border at which every march ends.
pub(super) struct RayMarching {
    width: usize,
    height: usize,
    /// Row by row, border included: [`WALL`], [`NEAR`], [`BORDER`], or the length of the leap in [`LEAP_UNIT`]s.
    leaps: Vec<u8>,
    max_range: f32,
}

impl RayMarching {
    pub(super) fn new(grid: &OccupancyGrid, max_range: f32) -> Self {
        let (width, height) = (grid.width() + 2, grid.height() + 2);
        let distances = DistanceField::new(grid.width(), grid.cells().iter().map(|&cell| cell == Cell::Occupied));
        let mut leaps = vec![BORDER; width * height];
        for row in 0..grid.height() {
            for column in 0..grid.width() {
                let distance = distances.at(column as i64, row as i64) as f32;
                // Distances are between centres; the start and the wall may each be half a diagonal nearer.
                let leap = ((distance - std::f32::consts::SQRT_2) / LEAP_UNIT) as u8;
                leaps[(row + 1) * width + column + 1] = if distance == 0.0 { WALL } else { leap.clamp(NEAR, BORDER - 1) };
            }
        }
        Self { width, height, leaps, max_range }
    }

    /// The length of a beam, cells; the start is given in coordinates that include the border.
    #[inline]
    fn length(&self, [x, y]: [f32; 2], direction: [f32; 2]) -> f32 {
        // Avoids a division by zero; within a map the difference does not matter.
        let [dx, dy] = direction.map(|part| if part.abs() < 1e-9 { 1e-9 } else { part });
        let (by_dx, by_dy) = (dx.recip(), dy.recip());
        let far_side = [dx, dy].map(|part| if part > 0.0 { 1.0_f32 } else { 0.0 });
        let mut length = 0.0_f32;
        while length <= self.max_range {
            let (column, row) = ((x + length * dx) as usize, (y + length * dy) as usize);
            match self.leaps[row * self.width + column] {
                WALL => return (length - INTO_CELL).max(0.0),
                BORDER => return f32::INFINITY,
                NEAR => {
                    let boundary_x = (column as f32 + far_side[0] - x) * by_dx;
                    let boundary_y = (row as f32 + far_side[1] - y) * by_dy;
                    length = boundary_x.min(boundary_y).max(length) + INTO_CELL;
                }
                leap => length += f32::from(leap) * LEAP_UNIT,
            }
        }
        f32::INFINITY
    }

    /// The start of the beams in coordinates that include the border; `None` outside the map.
    fn start(&self, from: &Viewpoint) -> Option<[f32; 2]> {
        let inside = from.x >= 0.0 && from.y >= 0.0 && from.x < (self.width - 2) as f32 && from.y < (self.height - 2) as f32;
        inside.then_some([from.x + 1.0, from.y + 1.0])
    }
}

impl RayCaster for RayMarching {
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]) {
        fan.fill(from, lengths, |from, beam| {
            self.start(from).map_or(f32::INFINITY, |start| self.length(start, beam.direction_from(from)))
        });
    }

    fn memory(&self) -> usize {
        self.leaps.len()
    }
}
