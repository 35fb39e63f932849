//! Which way the surface runs that a ray ends on, as the rays beside it tell: a chord, which is a vector along it.

use fearless_simd::{Simd, f32x8, mask32x8, prelude::*};

use crate::matching::surface::LANES;

/// Length of a chord, in standard deviations of a range: neighbours nearer than this tell of their own noise. From 3.5 to 7 all logs are
/// matched alike; from 9 on, directions outweigh the little that long corridors show.
const LENGTH: f32 = 5.0;
/// Neighbours are looked for 1, 2, 4 and so on rays away, up to so many.
pub(super) const FARTHEST: usize = 32;

/// The end points of all rays of a scan, in order, and a block of them. To either side there are [`FARTHEST`] more that are
/// none (NaN).
#[derive(Clone, Copy)]
pub(super) struct Neighbourhood<'a, S: Simd> {
    pub(super) simd: S,
    /// Coordinates, m.
    pub(super) x: &'a [f32],
    pub(super) y: &'a [f32],
    /// Place of the block's first.
    pub(super) first: usize,
    /// Variance of a range, m^2.
    pub(super) noise: f32,
}

impl<S: Simd> Neighbourhood<'_, S> {
    #[inline(always)]
    fn at(self, place: usize) -> [f32x8<S>; 2] {
        let lanes = place..place + LANES;
        [f32x8::from_slice(self.simd, &self.x[lanes.clone()]), f32x8::from_slice(self.simd, &self.y[lanes])]
    }

    /// The chords of the block, m. They are shorter where the gap to the next ray is more than half of their length, as neighbours need not
    /// be on one surface there, and zero where there are none.
    #[inline(always)]
    pub(super) fn chords(self) -> [f32x8<S>; 2] {
        let length_square = LENGTH * LENGTH * self.noise;
        let point = self.at(self.first);
        let [up, down] = self.sides(point, length_square);
        // By the inverse square of the distance: past an edge it is far.
        let (x, y) = (up[0] - down[0], up[1] - down[1]);
        let square = x * x + y * y;
        // What lies between two rays is not known.
        let gap_square = across(point, self.at(self.first + 1)).min(across(point, self.at(self.first - 1)));
        let gaps = gap_square * (2.0 * 2.0 / length_square);
        let factor = (length_square / (gaps.mul_add(gaps, 1.0) * square)).sqrt();
        let factor = square.simd_gt(0.0).select(factor, f32x8::splat(self.simd, 0.0));
        [x * factor, y * factor]
    }

    /// The ways to the nearest neighbours to either side that are far enough, by the square of their length, 1/m; zero without one.
    #[inline(always)]
    fn sides(self, point: [f32x8<S>; 2], length_square: f32) -> [[f32x8<S>; 2]; 2] {
        let none = Side::none(self.simd);
        let (mut up, mut down) = (none, none);
        let mut reach = 1;
        while reach <= FARTHEST && !(up.is_found & down.is_found).all_true() {
            up = up.or(point, self.at(self.first + reach), length_square);
            down = down.or(point, self.at(self.first - reach), length_square);
            reach *= 2;
        }
        [up.by_square(), down.by_square()]
    }
}

/// The ways to the neighbours to one side.
#[derive(Clone, Copy)]
struct Side<S: Simd> {
    way: [f32x8<S>; 2],
    /// Square of its length, m^2.
    square: f32x8<S>,
    is_found: mask32x8<S>,
}

impl<S: Simd> Side<S> {
    #[inline(always)]
    fn none(simd: S) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        Self { way: [zero, zero], square: zero, is_found: zero.simd_gt(0.0) }
    }

    /// The ways to others where there are none that are long enough.
    #[inline(always)]
    fn or(self, point: [f32x8<S>; 2], other: [f32x8<S>; 2], length_square: f32) -> Self {
        let x = self.is_found.select(self.way[0], other[0] - point[0]);
        let y = self.is_found.select(self.way[1], other[1] - point[1]);
        let square = x.mul_add(x, y * y);
        Self { way: [x, y], square, is_found: square.simd_ge(length_square) }
    }

    #[inline(always)]
    fn by_square(self) -> [f32x8<S>; 2] {
        let zero = f32x8::splat(self.square.token(), 0.0);
        let inverse = self.is_found.select(1.0 / self.square, zero);
        [self.is_found.select(self.way[0], zero) * inverse, self.is_found.select(self.way[1], zero) * inverse]
    }
}

/// Square of how far a point lies beside the ray to another, m^2; infinite where there is no other.
#[inline(always)]
fn across<S: Simd>(point: [f32x8<S>; 2], other: [f32x8<S>; 2]) -> f32x8<S> {
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
    const CHORD: f64 = (LENGTH * NOISE) as f64;

    #[inline(always)]
    fn chord<S: Simd>(simd: S, x: &[f32], y: &[f32], place: usize) -> Point {
        let [x, y] = Neighbourhood { simd, x, y, first: FARTHEST + place, noise: NOISE * NOISE }.chords();
        Point::new(x[0].into(), y[0].into())
    }

    fn chords(points: &[Point]) -> Vec<Point> {
        let padded = |coordinate: fn(&Point) -> f64| {
            let mut padded = vec![f32::NAN; points.len() + 2 * FARTHEST + LANES];
            padded.iter_mut().skip(FARTHEST).zip(points).for_each(|(padded, point)| *padded = coordinate(point) as f32);
            padded
        };
        let (x, y) = (padded(|point| point.x), padded(|point| point.y));
        (0..points.len()).map(|place| dispatch!(Level::new(), simd => chord(simd, &x, &y, place))).collect()
    }

    /// A wall 2 m ahead from bearing -0.5 to 0, and one 4 m ahead from there to 0.5, by so many rays.
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
    }
}
