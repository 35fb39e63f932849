//! The walls of a map, with one bit per cell.

use crate::map::grid::OccupancyGrid;

/// Bitmap of the walls, with a border of one cell at which every traversal ends.
#[derive(Clone, Debug)]
pub(super) struct WallBits {
    width: usize,
    height: usize,
    words: Vec<u64>,
}

impl WallBits {
    pub(super) fn new(grid: &OccupancyGrid) -> Self {
        let (walls, width) = grid.padded_walls(1);
        let mut bits = Self { width, height: grid.height() + 2, words: vec![0; walls.len().div_ceil(64)] };
        for (index, is_wall) in walls.into_iter().enumerate() {
            bits.words[index / 64] |= u64::from(is_wall || bits.is_border(index)) << (index % 64);
        }
        bits
    }

    /// Index difference between a cell and the one above it.
    pub(super) fn stride(&self) -> usize {
        self.width
    }

    /// Index of the cell that contains a point; `None` outside the map.
    #[inline]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked
    pub(super) fn index(&self, x: f32, y: f32) -> Option<usize> {
        let inside = x >= 0.0 && y >= 0.0 && x < (self.width - 2) as f32 && y < (self.height - 2) as f32;
        inside.then(|| (y as usize + 1) * self.width + x as usize + 1)
    }

    /// Whether a traversal ends in this cell: a wall, or the border.
    #[inline]
    pub(super) fn stops(&self, index: usize) -> bool {
        self.words[index / 64] >> (index % 64) & 1 == 1
    }

    /// Whether a cell belongs to the border around the map.
    pub(super) fn is_border(&self, index: usize) -> bool {
        let (column, row) = (index % self.width, index / self.width);
        column == 0 || row == 0 || column + 1 == self.width || row + 1 == self.height
    }

    pub(super) fn memory(&self) -> usize {
        size_of_val(self.words.as_slice())
    }
}
