//! Every answer computed beforehand: the lengths from the middle of every cell where a robot can be, in every direction.
//!
//! The answers are those of a [`Cddt`] with fine strips, for it is faster than to march every beam; it also answers where no robot is.

use super::cddt::Cddt;

use super::{Fan, RayCaster, Viewpoint, sector};
use crate::geometry::Pose2;
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;
use crate::parallel;

/// Directions of a full turn.
const DIRECTIONS: u32 = 360;
/// A cell that is not in the table: no robot is there. Should a beam be asked for all the same, the CDDT answers.
const NOT_LISTED: u32 = u32::MAX;
/// The entry of a beam that meets nothing.
const NOTHING: u16 = u16::MAX;
/// The largest entry that is a length.
const LONGEST: f32 = 65_000.0;
/// Strips of the CDDT in the width of a cell.
const FINENESS: f32 = 2.0;
/// Cells that are worked on together: from neighbours, in the same direction, the same strips are asked.
const CELLS: usize = 64;

/// The table.
pub(super) struct Table {
    width: usize,
    /// Which block of `lengths` is a cell's.
    blocks: Vec<u32>,
    lengths: Vec<u16>,
    /// Cells in a unit of `lengths`.
    unit: f32,
    others: Cddt,
}

impl Table {
    pub(super) fn new(grid: &OccupancyGrid, max_range: f32) -> Self {
        let others = Cddt::with(grid, max_range, DIRECTIONS, FINENESS);
        let diagonal = (grid.width() as f32).hypot(grid.height() as f32);
        let unit = max_range.min(diagonal) / LONGEST;
        let listed = indoor_cells(grid);
        let mut blocks = vec![NOT_LISTED; grid.cells().len()];
        for (block, &index) in listed.iter().enumerate() {
            blocks[index] = block as u32;
        }
        let directions = DIRECTIONS as usize;
        let mut lengths = vec![NOTHING; listed.len() * directions];
        parallel::map(lengths.chunks_mut(directions * CELLS).zip(listed.chunks(CELLS)), |(entries, cells)| {
            let middle =
                |index: &usize| Pose2::new((index % grid.width()) as f64 + 0.5, (index / grid.width()) as f64 + 0.5, 0.0);
            let middles: Vec<Viewpoint> = cells.iter().map(|index| Viewpoint::new(&middle(index))).collect();
            for direction in 0..directions {
                for (entries, middle) in entries.chunks_exact_mut(directions).zip(&middles) {
                    let length = others.length(middle, direction);
                    if length.is_finite() {
                        entries[direction] = (length / unit).min(LONGEST) as u16;
                    }
                }
            }
        });
        Self { width: grid.width(), blocks, lengths, unit, others }
    }

    /// The block of the cell that holds a point, if it has one.
    #[inline]
    fn block(&self, from: &Viewpoint) -> Option<usize> {
        let is_right = from.x >= 0.0 && from.y >= 0.0 && from.x < self.width as f32;
        let index = is_right.then(|| (from.y as usize).saturating_mul(self.width).saturating_add(from.x as usize))?;
        self.blocks.get(index).filter(|&&block| block != NOT_LISTED).map(|&block| block as usize)
    }
}

/// Memory that the table of a map takes, bytes.
pub(super) fn memory_for(grid: &OccupancyGrid) -> usize {
    indoor_cells(grid).len() * DIRECTIONS as usize * size_of::<u16>() + grid.cells().len() * size_of::<u32>()
}

impl RayCaster for Table {
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]) {
        fan.fill(from, lengths, |from, beam| {
            let direction = sector(beam.turn_from(from), DIRECTIONS);
            let Some(block) = self.block(from) else {
                return self.others.length_at_once(from).unwrap_or_else(|| self.others.length(from, direction));
            };
            let entry = self.lengths[block * DIRECTIONS as usize + direction];
            if entry == NOTHING { f32::INFINITY } else { f32::from(entry) * self.unit }
        });
    }

    fn memory(&self) -> usize {
        size_of_val(self.blocks.as_slice()) + size_of_val(self.lengths.as_slice()) + self.others.memory()
    }
}
