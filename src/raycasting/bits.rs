//! The walls of a map, with one bit per cell.

use crate::map::grid::{Cell, OccupancyGrid};

/// Bitmap of the walls, with a border of one cell at which every traversal ends.
#[derive(Clone, Debug)]
pub(super) struct WallBits {
    width: usize,
    height: usize,
    words: Vec<u64>,
}

impl WallBits {
    pub(super) fn new(grid: &OccupancyGrid) -> Self {
        let (width, height) = (grid.width() + 2, grid.height() + 2);
        let mut bits = Self { width, height, words: vec![0; (width * height).div_ceil(64)] };
        for index in 0..width * height {
            if bits.is_border(index) {
                bits.set(index);
            }
        }
        for (row, cells) in grid.cells().chunks_exact(grid.width()).enumerate() {
            for (column, _) in cells.iter().enumerate().filter(|(_, cell)| **cell == Cell::Occupied) {
                bits.set((row + 1) * width + column + 1);
            }
        }
        bits
    }

    fn set(&mut self, index: usize) {
        self.words[index / 64] |= 1 << (index % 64);
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
