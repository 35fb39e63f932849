//! Which way the surface runs that a ray ends on, as the rays beside it tell.

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};

use super::rays::Rays;
use crate::matching::surface::LANES;
use crate::scan::Scan;

/// Length of a chord, in standard deviations of a range: neighbours nearer than this tell of their own noise. From 3.5 to 7 all logs are
/// matched alike; from 9 on, directions outweigh the little that long corridors show.
const LENGTH: f32 = 5.0;
/// Neighbours are looked for in steps of 1, 2, 4 and so on, up to this.
const FARTHEST: usize = 32;

/// Finds a chord for each ray of a scan: a vector along its surface, m. It is shorter where the gap to the next ray is more than half of its
/// length, as neighbours need not be on one surface there, and zero where there are none.
#[derive(Debug, Default)]
pub(super) struct ChordFinder {
    /// Where rays end, by coordinate, between as many that end nowhere to either side as neighbours are looked for.
    padded: [Vec<f32>; 2],
}

impl ChordFinder {
    /// The rays of a scan, each with its chord. `noise`: standard deviation of a range, m.
    #[allow(clippy::cast_possible_truncation)] // to single precision
    pub(super) fn find(&mut self, level: Level, scan: &Scan, noise: f64, rays: &mut Rays) {
        let ends = scan.rays().map(|(_, direction, range)| [(direction.x * range) as f32, (direction.y * range) as f32]);
        rays.set_ends(scan.valid_len(), ends);
        dispatch!(level, simd => self.find_chords(simd, rays, noise as f32));
    }

    /// The chords of rays that are in order.
    #[inline(always)]
    fn find_chords<S: Simd>(&mut self, simd: S, rays: &mut Rays, noise: f32) {
        self.pad(rays);
        let [x, y] = &self.padded;
        let length_square = (LENGTH * noise).powi(2);
        for (block, (chord_x, chord_y)) in rays.chord_x.iter_mut().zip(&mut rays.chord_y).enumerate() {
            let around = Neighbourhood { simd, x, y, first: FARTHEST + block * LANES };
            let [x, y] = around.chords(length_square);
            x.store_slice(chord_x);
            y.store_slice(chord_y);
        }
    }

    fn pad(&mut self, rays: &Rays) {
        for (padded, own) in self.padded.iter_mut().zip([&rays.x, &rays.y]) {
            padded.clear();
            padded.resize(FARTHEST, f32::NAN);
            padded.extend_from_slice(&own.as_flattened()[..rays.len]);
            padded.resize(2 * FARTHEST + own.len() * LANES, f32::NAN);
        }
    }
}

/// A block of points, and those around it.
#[derive(Clone, Copy)]
struct Neighbourhood<'a, S: Simd> {
    simd: S,
    x: &'a [f32],
    y: &'a [f32],
    /// Place of the block's first point.
    first: usize,
}

impl<S: Simd> Neighbourhood<'_, S> {
    #[inline(always)]
    fn at(self, place: usize) -> [f32x8<S>; 2] {
        let lanes = place..place + LANES;
        [f32x8::from_slice(self.simd, &self.x[lanes.clone()]), f32x8::from_slice(self.simd, &self.y[lanes])]
    }

    /// Both sides count by the inverse square of the distance: past an edge it is far.
    #[inline(always)]
    fn chords(self, length_square: f32) -> [f32x8<S>; 2] {
        let point = self.at(self.first);
        let up = self.side(point, length_square, |reach| self.first + reach);
        let down = self.side(point, length_square, |reach| self.first - reach);
        let (x, y) = (up[0] - down[0], up[1] - down[1]);
        let square = x * x + y * y;
        // What lies between two rays is not known.
        let gap_square = across(point, self.at(self.first + 1)).min(across(point, self.at(self.first - 1)));
        let gaps = gap_square * (2.0 * 2.0 / length_square);
        let factor = (length_square / (gaps.mul_add(gaps, 1.0) * square)).sqrt();
        let factor = square.simd_gt(0.0).select(factor, f32x8::splat(self.simd, 0.0));
        [x * factor, y * factor]
    }

    /// The way to the nearest neighbour that is far enough, by the square of its length, 1/m; zero without one.
    #[inline(always)]
    fn side(self, point: [f32x8<S>; 2], length_square: f32, place: impl Fn(usize) -> usize) -> [f32x8<S>; 2] {
        let zero = f32x8::splat(self.simd, 0.0);
        let (mut x, mut y, mut square, mut is_found) = (zero, zero, zero, zero.simd_gt(0.0));
        let mut reach = 1;
        while reach <= FARTHEST && !is_found.all_true() {
            let neighbour = self.at(place(reach));
            let (dx, dy) = (neighbour[0] - point[0], neighbour[1] - point[1]);
            x = is_found.select(x, dx);
            y = is_found.select(y, dy);
            square = x.mul_add(x, y * y);
            is_found = square.simd_ge(length_square);
            reach *= 2;
        }
        let inverse = is_found.select(1.0 / square, zero);
        [is_found.select(x, zero) * inverse, is_found.select(y, zero) * inverse]
    }
}

/// Square of how far a point lies beside the ray to another, m^2; infinite where there is none.
#[inline(always)]
fn across<S: Simd>(point: [f32x8<S>; 2], other: [f32x8<S>; 2]) -> f32x8<S> {
    let cross = point[0] * other[1] - point[1] * other[0];
    let square = cross * cross / (point[0] * point[0] + point[1] * point[1]);
    square.simd_ge(0.0).select(square, f32x8::splat(point[0].token(), f32::INFINITY))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    const NOISE: f32 = 0.01;
    const CHORD: f64 = (LENGTH * NOISE) as f64;

    fn chords(points: &[Point]) -> Vec<Point> {
        let mut rays = Rays::default();
        rays.set_ends(points.len(), points.iter().map(|point| [point.x as f32, point.y as f32]));
        dispatch!(Level::new(), simd => ChordFinder::default().find_chords(simd, &mut rays, NOISE));
        rays.chords().map(|chord| chord.map(f64::from).into()).collect()
    }

    /// A wall 2 m ahead from bearing -0.5 to 0, and one 4 m ahead from there to 0.5, by so many rays.
    fn two_walls(rays: u32) -> Vec<Point> {
        let bearing = |i| f64::from(i) / f64::from(rays - 1) - 0.5;
        let distance = |bearing: f64| if bearing < 0.0 { 2.0 } else { 4.0 };
        (0..rays).map(bearing).map(|bearing| Point::new(1.0, bearing.tan()) * distance(bearing)).collect()
    }

    #[test]
    fn chords_run_along_surfaces_up_to_their_edges() {
        let all = chords(&two_walls(801));
        assert_eq!(all.len(), 801);
        for (i, chord) in all.iter().enumerate() {
            assert!(chord.norm() > 0.99 * CHORD && chord.norm() < 1.001 * CHORD, "{i}: {chord}");
            assert!(chord.x.abs() < 0.06 * CHORD, "{i}: {chord}");
        }
    }

    #[test]
    fn the_farther_rays_lie_apart_the_less_they_tell() {
        let length = |rays| chords(&two_walls(rays))[1].norm() / CHORD;
        assert!(length(401) > 0.98, "half a cm from ray to ray: {}", length(401));
        assert!((0.2..0.6).contains(&length(51)), "4 cm: {}", length(51));
        assert!(length(11) < 0.02, "20 cm: {}", length(11));
    }

    #[test]
    fn lone_points_have_none() {
        let point = Point::new(2.0, 0.1);
        assert_eq!(chords(&[point]), [Point::zeros()]);
        assert_eq!(chords(&[point, point * 1.001]), [Point::zeros(); 2], "too near to tell");
        assert!(chords(&[]).is_empty());
    }
}
