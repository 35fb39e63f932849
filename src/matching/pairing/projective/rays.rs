//! Rays of a scan by coordinate, eight at a time.

use fearless_simd::{Level, Simd, dispatch, prelude::*};

use super::Lanes;
use crate::matching::chords::{FARTHEST, Neighbourhood};
use crate::matching::ray_order::RayOrder;
use crate::matching::surface::LANES;
use crate::scan::Scan;

/// Where rays end, and the chord of the surface there, in the scan's frame, m; zeros past the last.
#[derive(Debug, Default)]
pub(super) struct Rays {
    pub(super) len: usize,
    pub(super) x: Vec<Lanes>,
    pub(super) y: Vec<Lanes>,
    pub(super) chord_x: Vec<Lanes>,
    pub(super) chord_y: Vec<Lanes>,
}

/// Eight of them.
#[derive(Clone, Copy)]
pub(super) struct Block<'a> {
    pub(super) point: [&'a Lanes; 2],
    pub(super) chord: [&'a Lanes; 2],
}

impl Rays {
    /// Takes over some of all rays.
    #[inline(always)]
    pub(super) fn choose(&mut self, all: &Self, order: RayOrder) {
        let own = [&mut self.x, &mut self.y, &mut self.chord_x, &mut self.chord_y];
        let theirs = [&all.x, &all.y, &all.chord_x, &all.chord_y];
        if order.is_all() {
            self.len = all.len;
            for (own, theirs) in own.into_iter().zip(theirs) {
                own.clone_from(theirs);
            }
            return;
        }
        self.resize(all.len);
        let (x, y) = (self.x.as_flattened_mut(), self.y.as_flattened_mut());
        let (chord_x, chord_y) = (self.chord_x.as_flattened_mut(), self.chord_y.as_flattened_mut());
        let [all_x, all_y, all_chord_x, all_chord_y] = theirs.map(|lanes| lanes.as_flattened());
        self.len = 0;
        let places = x.iter_mut().zip(y).zip(chord_x.iter_mut().zip(chord_y));
        for (((x, y), (chord_x, chord_y)), ray) in places.zip(order.rays()) {
            [*x, *y, *chord_x, *chord_y] = [all_x[ray], all_y[ray], all_chord_x[ray], all_chord_y[ray]];
            self.len += 1;
        }
        self.resize(self.len);
        self.clear_past_the_last();
    }

    /// Makes room for so many.
    fn resize(&mut self, len: usize) {
        self.len = len;
        for lanes in [&mut self.x, &mut self.y, &mut self.chord_x, &mut self.chord_y] {
            lanes.resize(len.div_ceil(LANES), [0.0; LANES]);
        }
    }

    fn clear_past_the_last(&mut self) {
        for lanes in [&mut self.x, &mut self.y, &mut self.chord_x, &mut self.chord_y] {
            lanes.as_flattened_mut()[self.len..].fill(0.0);
        }
    }

    pub(super) fn blocks(&self) -> impl Iterator<Item = Block<'_>> {
        let points = self.x.iter().zip(&self.y);
        let chords = self.chord_x.iter().zip(&self.chord_y);
        points.zip(chords).map(|((x, y), (chord_x, chord_y))| Block { point: [x, y], chord: [chord_x, chord_y] })
    }

    /// Where they end.
    pub(super) fn ends(&self) -> impl Iterator<Item = [f32; 2]> {
        let (x, y) = (self.x.as_flattened(), self.y.as_flattened());
        x.iter().zip(y).map(|(&x, &y)| [x, y]).take(self.len)
    }
}

/// All rays of a scan; keeps the memory that it takes to find their chords.
#[derive(Debug, Default)]
pub(super) struct AllRays {
    pub(super) rays: Rays,
    /// Where they end, by coordinate, between as many that end nowhere to either side as neighbours are looked for.
    padded: [Vec<f32>; 2],
}

impl AllRays {
    /// Takes over a scan. `noise`: standard deviation of a range, m.
    #[allow(clippy::cast_possible_truncation)] // to single precision
    pub(super) fn set(&mut self, level: Level, scan: &Scan, noise: f64) {
        self.rays.resize(scan.valid_len());
        let [x, y] = &mut self.padded;
        for padded in [&mut *x, &mut *y] {
            padded.clear();
            padded.resize(2 * FARTHEST + self.rays.x.len() * LANES, f32::NAN);
        }
        let ends = x[FARTHEST..].iter_mut().zip(&mut y[FARTHEST..]);
        for ((x, y), (_, direction, range)) in ends.zip(scan.rays()) {
            (*x, *y) = ((direction.x * range) as f32, (direction.y * range) as f32);
        }
        dispatch!(level, simd => self.find_chords(simd, (noise * noise) as f32));
        self.rays.clear_past_the_last();
    }

    #[inline(always)]
    fn find_chords<S: Simd>(&mut self, simd: S, noise: f32) {
        let [x, y] = &self.padded;
        let Rays { x: own_x, y: own_y, chord_x, chord_y, .. } = &mut self.rays;
        let ends = own_x.iter_mut().zip(own_y);
        for (block, ((own_x, own_y), (chord_x, chord_y))) in ends.zip(chord_x.iter_mut().zip(chord_y)).enumerate() {
            let first = FARTHEST + block * LANES;
            own_x.copy_from_slice(&x[first..first + LANES]);
            own_y.copy_from_slice(&y[first..first + LANES]);
            let [x, y] = Neighbourhood { simd, x, y, first, noise }.chords();
            x.store_slice(chord_x);
            y.store_slice(chord_y);
        }
    }
}
