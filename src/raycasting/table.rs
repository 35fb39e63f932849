//! Precomputed look-up table: the lengths from the centre of every cell where a robot can be, in every direction.
//!
//! The lengths come from a [`Cddt`] with fine strips, because that is faster than marching every beam. It also serves the cells outside
//! the table.

use super::cddt::Cddt;
use super::{Fan, RayCaster, Viewpoint, sector};
use crate::geometry::Pose2;
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;
use crate::parallel;

/// Number of directions.
const DIRECTIONS: u32 = 360;
/// Entry of a cell outside the table, where no robot can be; the CDDT serves such cells.
const NOT_LISTED: u32 = u32::MAX;
/// Entry of a beam that hits nothing.
const NOTHING: u16 = u16::MAX;
/// Largest entry that is a length.
const MAX_ENTRY: f32 = 65_000.0;
/// Number of CDDT strips per cell width.
const STRIPS_PER_CELL: f32 = 2.0;
/// Number of cells that are filled together: neighbours read the same strips, which stay in the cache.
const CHUNK_CELLS: usize = 64;

/// The look-up table.
pub(super) struct Table {
    width: usize,
    /// By cell: index of its block in `lengths`, or [`NOT_LISTED`].
    blocks: Vec<u32>,
    lengths: Vec<u16>,
    /// Unit of `lengths`, cells.
    unit: f32,
    cddt: Cddt,
}

impl Table {
    /// The table of a map, unless it needs more than `max_memory` bytes.
    pub(super) fn within(max_memory: usize, grid: &OccupancyGrid, max_range: f32) -> Option<Self> {
        let listed = indoor_cells(grid);
        let memory_of_lengths = listed.len() * DIRECTIONS as usize * size_of::<u16>();
        let table = (memory_of_lengths <= max_memory).then(|| Self::new(grid, &listed, max_range));
        table.filter(|table| table.memory() <= max_memory)
    }

    /// The table of the cells in `listed`.
    pub(super) fn new(grid: &OccupancyGrid, listed: &[usize], max_range: f32) -> Self {
        let cddt = Cddt::with(grid, max_range, DIRECTIONS, STRIPS_PER_CELL);
        let diagonal = (grid.width() as f32).hypot(grid.height() as f32);
        let unit = max_range.min(diagonal) / MAX_ENTRY;
        let mut blocks = vec![NOT_LISTED; grid.cells().len()];
        for (block, &index) in listed.iter().enumerate() {
            blocks[index] = block as u32;
        }
        let directions = DIRECTIONS as usize;
        let mut lengths = vec![NOTHING; listed.len() * directions];
        parallel::map(lengths.chunks_mut(directions * CHUNK_CELLS).zip(listed.chunks(CHUNK_CELLS)), |(entries, cells)| {
            let centre =
                |index: &usize| Pose2::new((index % grid.width()) as f64 + 0.5, (index / grid.width()) as f64 + 0.5, 0.0);
            let centres: Vec<Viewpoint> = cells.iter().map(|index| Viewpoint::new(&centre(index))).collect();
            for direction in 0..directions {
                for (entries, centre) in entries.chunks_exact_mut(directions).zip(&centres) {
                    let length = cddt.length(centre, direction);
                    if length.is_finite() {
                        entries[direction] = (length / unit).min(MAX_ENTRY) as u16;
                    }
                }
            }
        });
        Self { width: grid.width(), blocks, lengths, unit, cddt }
    }

    /// The block of the cell that contains a point, if the cell is in the table.
    #[inline]
    fn block(&self, from: &Viewpoint) -> Option<usize> {
        let is_within_width = from.x >= 0.0 && from.y >= 0.0 && from.x < self.width as f32;
        let index = is_within_width.then(|| (from.y as usize).saturating_mul(self.width).saturating_add(from.x as usize))?;
        self.blocks.get(index).filter(|&&block| block != NOT_LISTED).map(|&block| block as usize)
    }
}

impl RayCaster for Table {
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]) {
        fan.fill(from, lengths, |from, beam| {
            let direction = sector(beam.heading_from(from), DIRECTIONS);
            let Some(block) = self.block(from) else {
                return self.cddt.special_length(from).unwrap_or_else(|| self.cddt.length(from, direction));
            };
            let entry = self.lengths[block * DIRECTIONS as usize + direction];
            if entry == NOTHING { f32::INFINITY } else { f32::from(entry) * self.unit }
        });
    }

    fn memory(&self) -> usize {
        size_of_val(self.blocks.as_slice()) + size_of_val(self.lengths.as_slice()) + self.cddt.memory()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::grid::Cell;

    #[test]
    fn the_memory_limit_includes_everything() {
        let cells = (0..10_000).map(|i| if i % 7 == 0 { Cell::Occupied } else { Cell::Free }).collect();
        let grid = OccupancyGrid::new(100, 0.05, Pose2::IDENTITY, cells).unwrap();
        let memory = Table::new(&grid, &indoor_cells(&grid), 600.0).memory();
        assert!(Table::within(memory, &grid, 600.0).is_some() && Table::within(memory - 1, &grid, 600.0).is_none());
    }
}
