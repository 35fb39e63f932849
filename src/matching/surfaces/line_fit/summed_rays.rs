//! The rays of a scan, and running sums over them.

use fearless_simd::{f32x8, f64x4, prelude::*};

use super::padded::{Padded, Window};
use super::{HALF, MAX_REACH};
use crate::matching::surface::LANES;
use crate::scan::Scan;

/// The rays of a scan that have a measurement.
#[derive(Debug, Default)]
pub(super) struct SummedRays {
    pub(super) beams: Vec<u32>,
    /// Ranges, m.
    ranges: Padded<f32>,
    /// Unit vectors along the rays, by coordinate.
    directions: [Padded<f32>; 2],
    /// End points of the rays, by coordinate, m.
    points: [Padded<f32>; 2],
    /// Running sums over the preceding rays: of `w v v'` (xx, xy, yy), `w v / r` (x, y) and `w / r^2`, with `w = r^4`.
    sums: [Padded<f64>; 6],
}

impl SummedRays {
    /// Copies the measurements of a scan.
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision, and at most 10 000 beams
    pub(super) fn set(&mut self, scan: &Scan) {
        let len = scan.valid_len();
        self.beams.resize(len, 0);
        self.sums.iter_mut().for_each(|sums| sums.resize(len + 1));
        let [vx, vy] = &mut self.directions;
        let [x, y] = &mut self.points;
        for padded in [&mut self.ranges, vx, vy, x, y] {
            padded.resize(len);
        }
        let measured = self.beams.iter_mut().zip(self.ranges.values()).zip(vx.values()).zip(vy.values());
        for ((((own_beam, own_range), vx), vy), (beam, direction, range)) in measured.zip(scan.rays()) {
            (*own_beam, *own_range, *vx, *vy) = (beam as u32, range as f32, direction.x as f32, direction.y as f32);
        }
    }

    /// Computes the end points and the running sums.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&mut self, simd: S) {
        let mut before = [f64x4::splat(simd, 0.0); 6];
        for first in (0..self.beams.len()).step_by(LANES) {
            let range = f32x8::from_slice(simd, self.ranges.block(first));
            let [vx, vy] = &mut self.directions;
            let (x, y) = (f32x8::from_slice(simd, vx.block(first)) * range, f32x8::from_slice(simd, vy.block(first)) * range);
            x.store_slice(self.points[0].block(first));
            y.store_slice(self.points[1].block(first));
            let ((x_low, x_high), (y_low, y_high)) = (x.widen(), y.widen());
            for (half, (x, y)) in [(x_low, y_low), (x_high, y_high)].into_iter().enumerate() {
                let (square_x, square_y) = (x * x, y * y);
                let square = square_x + square_y;
                let terms = [square * square_x, square * x * y, square * square_y, square * x, square * y, square];
                for ((before, term), sums) in before.iter_mut().zip(terms).zip(&mut self.sums) {
                    let running = running_sum(term) + *before;
                    running.store_slice(&mut sums.block(first + 1)[half * HALF..][..HALF]);
                    *before = f64x4::splat(simd, running[HALF - 1]);
                }
            }
        }
        for sums in &mut self.sums {
            sums.values()[0] = 0.0;
            sums.repeat_ends();
        }
        self.points.iter_mut().for_each(Padded::repeat_ends);
    }

    /// The neighbourhood of the block of rays that starts at `first`. `noise`: variance of a range, m^2.
    #[inline(always)]
    pub(super) fn window<S: Simd>(&self, simd: S, first: usize, noise: f32) -> RayWindow<'_, S> {
        let (directions, points, sums) = (&self.directions, &self.points, &self.sums);
        let sum = |k: usize| sums[k].window(first);
        RayWindow {
            directions: [directions[0].window(first), directions[1].window(first)],
            points: [points[0].window(first), points[1].window(first)],
            sums: [sum(0), sum(1), sum(2), sum(3), sum(4), sum(5)],
            index: f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + first as f32,
            len: self.beams.len() as f32,
            noise,
        }
    }
}

/// The sum of each lane and all lanes before it.
#[inline(always)]
fn running_sum<S: Simd>(terms: f64x4<S>) -> f64x4<S> {
    let zero = f64x4::splat(terms.token(), 0.0);
    let pairs = terms + zero.slide::<3>(terms);
    pairs + zero.slide::<2>(pairs)
}

/// The neighbourhood of a block of rays, as far as stretches reach.
pub(super) struct RayWindow<'a, S: Simd> {
    pub(super) directions: [&'a Window<f32>; 2],
    pub(super) points: [&'a Window<f32>; 2],
    pub(super) sums: [&'a Window<f64>; 6],
    /// Indices of the rays of the block.
    pub(super) index: f32x8<S>,
    /// Total number of rays.
    pub(super) len: f32,
    /// Variance of a range, m^2.
    pub(super) noise: f32,
}

impl<S: Simd> RayWindow<'_, S> {
    /// Indices of the first rays of the stretches up to `reach` to either side, and of the rays after their last ones.
    #[inline(always)]
    pub(super) fn ends(&self, reach: f32x8<S>) -> (f32x8<S>, f32x8<S>) {
        ((self.index - reach).max(0.0), (self.index + reach + 1.0).min(self.len))
    }

    /// Directions and end points of the rays of the block.
    #[inline(always)]
    pub(super) fn block(&self, simd: S) -> [[f32x8<S>; 2]; 2] {
        let middle = |window: &Window<f32>| f32x8::from_slice(simd, &window[MAX_REACH..MAX_REACH + LANES]);
        let ([vx, vy], [x, y]) = (self.directions, self.points);
        [[middle(vx), middle(vy)], [middle(x), middle(y)]]
    }
}
