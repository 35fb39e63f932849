//! Chords: vectors along the surfaces that rays end on, estimated from the neighbouring rays.

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};

use crate::matching::surface::LANES;

/// Length of a chord, in standard deviations of a range: the direction to a nearer neighbour is dominated by noise. From 3.5 to
/// 7, all logs are matched equally well; from 9 on, the directions outweigh the little information in long corridors.
const CHORD_SIGMAS: f32 = 5.0;
/// Neighbours are tried at distances of 1, 2, 4, ... rays, up to this many.
pub(super) const MAX_NEIGHBOUR: usize = 32;

/// A block of rays and the end points of all rays of a scan, in order, padded with [`MAX_NEIGHBOUR`] invalid points (NaN) on
/// either side.
#[derive(Clone, Copy)]
pub(super) struct Neighbourhood<'a, S: Simd> {
    pub(super) simd: S,
    /// Coordinates, m.
    pub(super) x: &'a [f32],
    pub(super) y: &'a [f32],
    /// Index of the first ray of the block.
    pub(super) first: usize,
    /// Variance of a range, m^2.
    pub(super) noise: f32,
}

impl<S: Simd> Neighbourhood<'_, S> {
    #[inline(always)]
    fn block_at(self, index: usize) -> [f32x8<S>; 2] {
        let lanes = index..index + LANES;
        [f32x8::from_slice(self.simd, &self.x[lanes.clone()]), f32x8::from_slice(self.simd, &self.y[lanes])]
    }

    /// The chords of the block, m. A chord is shortened if the gap to the next ray is more than half its length, because the
    /// neighbours need not be on the same surface then. It is zero if there are no neighbours.
    #[inline(always)]
    pub(super) fn chords(self) -> [f32x8<S>; 2] {
        let squared_length = CHORD_SIGMAS * CHORD_SIGMAS * self.noise;
        let point = self.block_at(self.first);
        let [up, down] = self.neighbours(point, squared_length);
        // Weighted by the inverse squared distance: a neighbour past an edge is far and counts little.
        let (x, y) = (up[0] - down[0], up[1] - down[1]);
        let square = x * x + y * y;
        // The surface between two rays is unknown.
        let squared_gap = squared_distance_from_ray(point, self.block_at(self.first + 1))
            .min(squared_distance_from_ray(point, self.block_at(self.first - 1)));
        let gaps = squared_gap * (2.0 * 2.0 / squared_length);
        let factor = (squared_length / (gaps.mul_add(gaps, 1.0) * square)).sqrt();
        let factor = square.simd_gt(0.0).select(factor, f32x8::splat(self.simd, 0.0));
        [x * factor, y * factor]
    }

    /// Offsets to the nearest neighbours on either side that are far enough, divided by their squared length, 1/m; zero if there
    /// is none.
    #[inline(always)]
    fn neighbours(self, point: [f32x8<S>; 2], squared_length: f32) -> [[f32x8<S>; 2]; 2] {
        let none = Neighbours::none(self.simd);
        let (mut up, mut down) = (none, none);
        let mut stride = 1;
        while stride <= MAX_NEIGHBOUR && !(up.is_found & down.is_found).all_true() {
            up = up.or_at(point, self.block_at(self.first + stride), squared_length);
            down = down.or_at(point, self.block_at(self.first - stride), squared_length);
            stride *= 2;
        }
        [up.inverse_square_weighted(), down.inverse_square_weighted()]
    }
}

/// Offsets to the neighbours on one side.
#[derive(Clone, Copy)]
struct Neighbours<S: Simd> {
    offset: [f32x8<S>; 2],
    /// Squared length of the offset, m^2.
    square: f32x8<S>,
    is_found: mask32x8<S>,
}

impl<S: Simd> Neighbours<S> {
    #[inline(always)]
    fn none(simd: S) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        Self { offset: [zero, zero], square: zero, is_found: zero.simd_gt(0.0) }
    }

    /// Replaces offsets that are not long enough yet by those to other points.
    #[inline(always)]
    fn or_at(self, point: [f32x8<S>; 2], other: [f32x8<S>; 2], squared_length: f32) -> Self {
        let x = self.is_found.select(self.offset[0], other[0] - point[0]);
        let y = self.is_found.select(self.offset[1], other[1] - point[1]);
        let square = x.mul_add(x, y * y);
        Self { offset: [x, y], square, is_found: square.simd_ge(squared_length) }
    }

    #[inline(always)]
    fn inverse_square_weighted(self) -> [f32x8<S>; 2] {
        let zero = f32x8::splat(self.square.token(), 0.0);
        let inverse = self.is_found.select(1.0 / self.square, zero);
        [self.is_found.select(self.offset[0], zero) * inverse, self.is_found.select(self.offset[1], zero) * inverse]
    }
}

/// Squared distance of another point from the ray to `point`, m^2; infinite if there is no other point.
#[inline(always)]
fn squared_distance_from_ray<S: Simd>(point: [f32x8<S>; 2], other: [f32x8<S>; 2]) -> f32x8<S> {
    let cross = point[0] * other[1] - point[1] * other[0];
    let square = cross * cross / (point[0] * point[0] + point[1] * point[1]);
    square.simd_gt(0.0).select(square, f32x8::splat(point[0].token(), f32::INFINITY))
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::geometry::Point;

    const NOISE: f32 = 0.01;
    const CHORD: f64 = (CHORD_SIGMAS * NOISE) as f64;

    #[inline(always)]
    fn chord<S: Simd>(simd: S, x: &[f32], y: &[f32], index: usize) -> Point {
        let [x, y] = Neighbourhood { simd, x, y, first: MAX_NEIGHBOUR + index, noise: NOISE * NOISE }.chords();
        Point::new(x[0].into(), y[0].into())
    }

    fn chords(points: &[Point]) -> Vec<Point> {
        let padded = |coordinate: fn(&Point) -> f64| {
            let mut padded = vec![f32::NAN; points.len() + 2 * MAX_NEIGHBOUR + LANES];
            padded.iter_mut().skip(MAX_NEIGHBOUR).zip(points).for_each(|(padded, point)| *padded = coordinate(point) as f32);
            padded
        };
        let (x, y) = (padded(|point| point.x), padded(|point| point.y));
        (0..points.len()).map(|index| dispatch!(Level::new(), simd => chord(simd, &x, &y, index))).collect()
    }

    /// A wall 2 m ahead from bearing -0.5 to 0, and one 4 m ahead from there to 0.5, seen by this many rays.
    fn two_walls(rays: u32) -> Vec<Point> {
        let bearing = |i| f64::from(i) / f64::from(rays - 1) - 0.5;
        let distance = |bearing: f64| if bearing < 0.0 { 2.0 } else { 4.0 };
        (0..rays).map(bearing).map(|bearing| Point::new(1.0, bearing.tan()) * distance(bearing)).collect()
    }

    #[test]
    fn chords_run_along_surfaces_up_to_their_edges() {
        for (i, chord) in chords(&two_walls(801)).iter().enumerate() {
            assert!(chord.norm() > 0.99 * CHORD && chord.norm() < 1.001 * CHORD, "{i}: {chord}");
            assert!(chord.x.abs() < 0.06 * CHORD, "{i}: {chord}");
        }
    }

    #[test]
    fn chords_shorten_with_the_distance_between_rays() {
        let length = |rays| chords(&two_walls(rays))[1].norm() / CHORD;
        assert!(length(401) > 0.98, "half a cm from ray to ray: {}", length(401));
        assert!((0.2..0.6).contains(&length(51)), "4 cm: {}", length(51));
        assert!(length(11) < 0.02, "20 cm: {}", length(11));
    }

    #[test]
    fn isolated_points_have_no_chord() {
        let point = Point::new(2.0, 0.1);
        assert_eq!(chords(&[point]), [Point::zeros()]);
        assert_eq!(chords(&[point, point * 1.001]), [Point::zeros(); 2], "too near for a direction");
    }
}
