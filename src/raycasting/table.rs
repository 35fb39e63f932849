//! Every answer computed beforehand: the lengths from the middle of every cell where a robot can be, in every direction.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::ray_marching::RayMarching;
use super::{Fan, RayCaster, Viewpoint, sector};
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;

/// Directions of a full turn.
const DIRECTIONS: u32 = 360;
/// A cell that is not in the table: no robot is there. Should a beam be asked for all the same, it is marched.
const NOT_LISTED: u32 = u32::MAX;
/// The entry of a beam that meets nothing.
const NOTHING: u16 = u16::MAX;
/// The largest entry that is a length.
const LONGEST: f32 = 65_000.0;

/// The table.
pub(super) struct Table {
    width: usize,
    /// Which block of `lengths` is a cell's.
    blocks: Vec<u32>,
    lengths: Vec<u16>,
    /// Cells in a unit of `lengths`.
    unit: f32,
    others: RayMarching,
}

impl Table {
    pub(super) fn new(grid: &OccupancyGrid, max_range: f32) -> Self {
        let others = RayMarching::new(grid, max_range);
        let diagonal = (grid.width() as f32).hypot(grid.height() as f32);
        let unit = max_range.min(diagonal) / LONGEST;
        let listed = indoor_cells(grid);
        let mut blocks = vec![NOT_LISTED; grid.cells().len()];
        for (block, &index) in listed.iter().enumerate() {
            blocks[index] = block as u32;
        }
        let directions: Vec<[f32; 2]> = (0..DIRECTIONS)
            .map(|index| (f64::from(index) * TAU / f64::from(DIRECTIONS)).sin_cos())
            .map(|(sin, cos)| [cos as f32, sin as f32])
            .collect();
        let mut lengths = vec![NOTHING; listed.len() * directions.len()];
        lengths.par_chunks_exact_mut(directions.len()).zip(&listed).for_each(|(block, index)| {
            let middle = [index % grid.width(), index / grid.width()].map(|cell| cell as f32 + 1.5);
            for (entry, &direction) in block.iter_mut().zip(&directions) {
                let length = others.length(middle, direction);
                if length.is_finite() {
                    *entry = (length / unit).min(LONGEST) as u16;
                }
            }
        });
        Self { width: grid.width(), blocks, lengths, unit, others }
    }
}

impl RayCaster for Table {
    fn cast(&self, from: &[Viewpoint], fan: &Fan, lengths: &mut [f32]) {
        fan.fill(from, lengths, |from, beam| {
            let Some(start) = self.others.start(from) else { return f32::INFINITY };
            let block = self.blocks[from.y as usize * self.width + from.x as usize];
            if block == NOT_LISTED {
                return self.others.length(start, beam.direction_from(from));
            }
            let entry = self.lengths[block as usize * DIRECTIONS as usize + sector(beam.turn_from(from), DIRECTIONS)];
            if entry == NOTHING { f32::INFINITY } else { f32::from(entry) * self.unit }
        });
    }

    fn memory(&self) -> usize {
        size_of_val(self.blocks.as_slice()) + size_of_val(self.lengths.as_slice()) + self.others.memory()
    }
}
