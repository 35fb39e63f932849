//! Rays of a scan by coordinate, eight at a time.

use super::Lanes;
use crate::matching::ray_order::RayOrder;
use crate::matching::surface::LANES;

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
    /// Takes over where so many rays end; their chords are yet to come.
    pub(super) fn set_ends(&mut self, len: usize, ends: impl Iterator<Item = [f32; 2]>) {
        self.resize(len);
        let (all_x, all_y) = (self.x.as_flattened_mut(), self.y.as_flattened_mut());
        for ((x, y), end) in all_x.iter_mut().zip(all_y).zip(ends) {
            [*x, *y] = end;
        }
        self.clear_past_the_last();
    }

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
        self.each(&self.x, &self.y)
    }

    /// Their chords.
    pub(super) fn chords(&self) -> impl Iterator<Item = [f32; 2]> {
        self.each(&self.chord_x, &self.chord_y)
    }

    fn each<'a>(&self, x: &'a [Lanes], y: &'a [Lanes]) -> impl Iterator<Item = [f32; 2]> + use<'a> {
        x.as_flattened().iter().zip(y.as_flattened()).map(|(&x, &y)| [x, y]).take(self.len)
    }
}
