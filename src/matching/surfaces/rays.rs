//! Rays of the sensed scan as blocks of eight for SIMD.

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};

use super::chords::{MAX_NEIGHBOUR, Neighbourhood};
use crate::matching::ray_order::RayOrder;
use crate::matching::surface::LANES;
use crate::scan::Scan;

/// Eight rays in the frame of the scan; padded with zeros after the last ray.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    /// End points, m.
    pub(super) point: [[f32; LANES]; 2],
    /// Chords of the surfaces at the end points, m.
    pub(super) chord: [[f32; LANES]; 2],
    /// Inverse squared ranges, 1/m^2.
    pub(super) inverse_square: [f32; LANES],
}

impl Block {
    /// Copies a ray from another block.
    #[inline(always)]
    fn copy(&mut self, lane: usize, other: &Self, from: usize) {
        self.inverse_square[lane] = other.inverse_square[from];
        for axis in 0..2 {
            self.point[axis][lane] = other.point[axis][from];
            self.chord[axis][lane] = other.chord[axis][from];
        }
    }
}

/// Rays of a scan.
#[derive(Debug, Default)]
pub(super) struct Rays {
    pub(super) len: usize,
    pub(super) blocks: Vec<Block>,
}

impl Rays {
    /// Selects the rays of an order from all rays.
    pub(super) fn select(&mut self, all: &Self, order: RayOrder) {
        if order.is_all() {
            self.len = all.len;
            self.blocks.clone_from(&all.blocks);
            return;
        }
        self.len = 0;
        self.blocks.clear();
        let mut rays = order.rays();
        let mut next = rays.next();
        while next.is_some() {
            let mut block = Block::default();
            for lane in 0..LANES {
                let Some(ray) = next else { break };
                block.copy(lane, &all.blocks[ray / LANES], ray % LANES);
                self.len += 1;
                next = rays.next();
            }
            self.blocks.push(block);
        }
    }

    fn clear_padding(&mut self) {
        let Some(Block { point: [x, y], chord: [chord_x, chord_y], inverse_square }) = self.blocks.last_mut() else { return };
        for lanes in [x, y, chord_x, chord_y, inverse_square] {
            lanes[(self.len - 1) % LANES + 1..].fill(0.0);
        }
    }

    /// End points, m.
    pub(super) fn end_points(&self) -> impl Iterator<Item = [f32; 2]> {
        let end_points = |block: &Block| -> [[f32; 2]; LANES] { std::array::from_fn(|lane| block.point.map(|axis| axis[lane])) };
        self.blocks.iter().flat_map(end_points).take(self.len)
    }

    /// Mean range, m.
    pub(super) fn mean_range(&self, level: Level) -> f64 {
        dispatch!(level, simd => self.sum_of_ranges(simd)) / self.len.max(1) as f64
    }

    #[inline(always)]
    fn sum_of_ranges<S: Simd>(&self, simd: S) -> f64 {
        let mut ranges = f32x8::splat(simd, 0.0);
        for block in &self.blocks {
            ranges += squared_ranges(simd, block).sqrt();
        }
        f64::from(ranges.reduce_sum())
    }
}

#[inline(always)]
fn squared_ranges<S: Simd>(simd: S, block: &Block) -> f32x8<S> {
    let [x, y] = [0, 1].map(|axis| f32x8::from_slice(simd, &block.point[axis]));
    x.mul_add(x, y * y)
}

/// All rays of a scan, with the buffers for computing their chords.
#[derive(Debug, Default)]
pub(super) struct AllRays {
    pub(super) rays: Rays,
    /// End points by coordinate, padded with NaN on either side for the neighbour search.
    padded: [Vec<f32>; 2],
}

impl AllRays {
    /// Sets the scan. `noise`: standard deviation of a range, m.
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision
    pub(super) fn set(&mut self, level: Level, scan: &Scan, noise: f64) {
        self.rays.len = scan.valid_len();
        self.rays.blocks.resize(self.rays.len.div_ceil(LANES), Block::default());
        let [x, y] = &mut self.padded;
        for padded in [&mut *x, &mut *y] {
            padded.clear();
            padded.resize(2 * MAX_NEIGHBOUR + self.rays.blocks.len() * LANES, f32::NAN);
        }
        let end_points = x[MAX_NEIGHBOUR..].iter_mut().zip(&mut y[MAX_NEIGHBOUR..]);
        for ((x, y), (_, direction, range)) in end_points.zip(scan.rays()) {
            (*x, *y) = ((direction.x * range) as f32, (direction.y * range) as f32);
        }
        dispatch!(level, simd => self.fill_blocks(simd, (noise * noise) as f32));
        self.rays.clear_padding();
    }

    #[inline(always)]
    fn fill_blocks<S: Simd>(&mut self, simd: S, noise: f32) {
        let [x, y] = &self.padded;
        for (i, block) in self.rays.blocks.iter_mut().enumerate() {
            let first = MAX_NEIGHBOUR + i * LANES;
            block.point[0].copy_from_slice(&x[first..first + LANES]);
            block.point[1].copy_from_slice(&y[first..first + LANES]);
            let neighbourhood = Neighbourhood { simd, x, y, first, noise };
            for (axis, chord) in neighbourhood.chords().into_iter().enumerate() {
                chord.store_slice(&mut block.chord[axis]);
            }
            (1.0 / squared_ranges(simd, block)).store_slice(&mut block.inverse_square);
        }
    }
}
