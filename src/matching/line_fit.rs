//! Lines fitted to stretches of a scan: what two neighbouring points say of a wall drowns in their noise, what a whole stretch of it
//! says does not.
//!
//! A line `n . x = d` seen from the laser has the inverse range `1/r = (n . v)/d` along the unit vector v: linear in `n/d`, so that
//! a weighted linear least-squares fit finds it. A range of standard deviation sigma makes an inverse range of sigma/r^2: weight r^4.
//! Sums over any stretch are differences of running sums. Of the stretches around a ray that one is taken which makes the line
//! surest: over a longer one the noise averages out, while what is no line shows as an excess of the residuals over the noise and
//! does not. A ray near a corner, where its own stretch is short, belongs to a longer one of its neighbours.

use fearless_simd::{Level, dispatch, f32x8, f64x4, prelude::*};

use super::view::Surface;
use crate::scan::Scan;

/// Rays to either side of its middle that the longest stretch has. The others have half as many as the next longer one.
const LONGEST: usize = 32;
/// A ray may belong to the stretches of the rays so far from it.
const NEIGHBOURS: [usize; 6] = [1, 2, 4, 8, 16, LONGEST - 1];
/// A point farther from a line than this many standard deviations is not on it.
const FARTHEST: f32 = 3.0;
/// What is more uneven is no surface: standard deviation, m.
const ROUGHEST: f64 = 0.1;
/// Points are paired with a surface up to so far along it from the place that it was fitted at, m: the lever of its direction's error.
const LEVER: f64 = 0.05;

/// Few rays lie on a line by chance, and seem sure. Stretches are compared as if they had erred by so much more, in all: of a long one
/// each ray's share is small. With less, noise that is greater than assumed leads to lines through three rays.
const DOUBT: f64 = 40.0;

/// Rays that are handled at a time, in single precision and in double.
const LANES: usize = 8;
const HALF: usize = LANES / 2;
/// By how much padded numbers are more than the rays.
const PADDING: usize = 2 * LONGEST + LANES + 1;
/// The numbers of all rays near [`LANES`] of them.
type Window<T> = [T; PADDING];

/// Numbers by ray, or sums over the rays before each, and more at either end, as far as stretches reach: none need know where the scan
/// ends.
#[derive(Debug, Default)]
struct Padded<T>(Vec<T>);

impl<T: Copy + Default> Padded<T> {
    fn resize(&mut self, len: usize) -> &mut [T] {
        self.0.resize(len + PADDING, T::default());
        &mut self.0[LONGEST..LONGEST + len]
    }

    fn pad(&mut self, before: T, after: T) {
        let end = self.0.len() - PADDING + LONGEST;
        self.0[..LONGEST].fill(before);
        self.0[end..].fill(after);
    }

    fn repeat_ends(&mut self) {
        let end = self.0.len() - PADDING + LONGEST;
        self.pad(self.0[LONGEST], self.0[end - 1]);
    }

    /// The numbers from `ray` on, with some of the padding: whole blocks.
    fn block(&mut self, ray: usize) -> &mut [T] {
        &mut self.0[LONGEST + ray..LONGEST + ray + LANES]
    }

    #[inline(always)]
    fn window(&self, ray: usize) -> &Window<T> {
        // There are as many numbers, for every ray.
        self.0[ray..].first_chunk().unwrap_or_else(|| unreachable!())
    }
}

/// The rays of a scan that carry a measurement.
#[derive(Debug, Default)]
struct Rays {
    beams: Vec<usize>,
    /// Unit vectors, by coordinate.
    directions: [Padded<f64>; 2],
    /// Where the rays end, by coordinate, m.
    points: [Padded<f64>; 2],
    /// Sums over the rays before each: of `w v v'` (xx, xy, yy), `w v / r` (x, y) and `w / r^2`, with `w = r^4`.
    sums: [Padded<f64>; 6],
}

impl Rays {
    fn set(&mut self, scan: &Scan) {
        self.beams.clear();
        let len = scan.valid_len();
        let [vx, vy] = self.directions.each_mut().map(|padded| padded.resize(len));
        let [x, y] = self.points.each_mut().map(|padded| padded.resize(len));
        let [xx, xy, yy, sx, sy, squares] = self.sums.each_mut().map(|padded| padded.resize(len + 1));
        let mut sum = [0.0; 6];
        for (i, (beam, direction, range)) in scan.rays().enumerate().take(len) {
            let point = direction * range;
            self.beams.push(beam);
            (vx[i], vy[i], x[i], y[i]) = (direction.x, direction.y, point.x, point.y);
            let (square_x, square_y) = (point.x * point.x, point.y * point.y);
            let square = square_x + square_y;
            let terms =
                [square * square_x, square * point.x * point.y, square * square_y, square * point.x, square * point.y, square];
            sum = std::array::from_fn(|k| sum[k] + terms[k]);
            [xx[i + 1], xy[i + 1], yy[i + 1], sx[i + 1], sy[i + 1], squares[i + 1]] = sum;
        }
        self.sums.iter_mut().chain(&mut self.points).chain(&mut self.directions).for_each(Padded::repeat_ends);
    }
}

/// Rays taken to be on one line each, lane by lane.
#[derive(Clone, Copy)]
struct Fit<S: Simd> {
    /// Index of the first ray, and of the one after the last.
    start: f64x4<S>,
    end: f64x4<S>,
    /// `n/d`.
    inverse: [f64x4<S>; 2],
    /// Mean squared range error about the line beyond the noise's: what is uneven. In units of the noise's variance, as all that follows.
    excess: f64x4<S>,
    /// Variance of the line's place in its middle, as a range.
    mean: f64x4<S>,
    /// Variance of its direction, rad^2.
    turn: f64x4<S>,
    /// Variance of a point's distance from it; infinite where it is no surface.
    variance: f64x4<S>,
    /// The same with [`DOUBT`], to compare.
    doubted: f64x4<S>,
}

impl<S: Simd> Fit<S> {
    /// The others where they are surer.
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        let surer = other.doubted.simd_lt(self.doubted);
        let either = |other: f64x4<S>, own: f64x4<S>| surer.select(other, own);
        Self {
            start: either(other.start, self.start),
            end: either(other.end, self.end),
            inverse: [either(other.inverse[0], self.inverse[0]), either(other.inverse[1], self.inverse[1])],
            excess: either(other.excess, self.excess),
            mean: either(other.mean, self.mean),
            turn: either(other.turn, self.turn),
            variance: either(other.variance, self.variance),
            doubted: either(other.doubted, self.doubted),
        }
    }

    #[inline(always)]
    fn stretch(self) -> Stretch<f64x4<S>> {
        let offset = 1.0 / (self.inverse[0] * self.inverse[0] + self.inverse[1] * self.inverse[1]).sqrt();
        let infinite = f64x4::splat(offset.token(), f64::INFINITY);
        Stretch {
            middle: (self.start + self.end - 1.0) * 0.5,
            per_ray: 2.0 / (self.end - self.start),
            normal: [self.inverse[0] * offset, self.inverse[1] * offset],
            offset,
            excess: self.excess,
            mean: self.mean,
            turn: self.variance.simd_lt(f64::INFINITY).select(self.turn, infinite),
        }
    }
}

/// What is around some rays.
struct Around<'a> {
    directions: [&'a Window<f64>; 2],
    points: [&'a Window<f64>; 2],
    sums: [&'a Window<f64>; 6],
    /// Index of the first of the rays, and number of rays in all.
    first: f64,
    len: f64,
    /// Standard deviation of a range, m.
    noise: f64,
}

impl Around<'_> {
    /// The surest lines that have the rays from `lane` on in their middles.
    #[inline(always)]
    fn best<S: Simd>(&self, simd: S, lane: usize) -> Fit<S> {
        self.fit::<S, 1>(simd, lane)
            .or(self.fit::<S, 2>(simd, lane))
            .or(self.fit::<S, 4>(simd, lane))
            .or(self.fit::<S, 8>(simd, lane))
            .or(self.fit::<S, 16>(simd, lane))
            .or(self.fit::<S, LONGEST>(simd, lane))
    }

    /// The lines through the rays up to `REACH` to either side.
    #[inline(always)]
    fn fit<S: Simd, const REACH: usize>(&self, simd: S, lane: usize) -> Fit<S> {
        let at = |window: &Window<f64>, place: usize| f64x4::from_slice(simd, &window[place + lane..place + lane + HALF]);
        let over = |sums: &Window<f64>| at(sums, LONGEST + REACH + 1) - at(sums, LONGEST - REACH);
        let [xx, xy, yy, x, y, squares] = self.sums;
        let (xx, xy, yy, x, y, squares) = (over(xx), over(xy), over(yy), over(x), over(y), over(squares));
        let per_determinant = 1.0 / (xx * yy - xy * xy);
        let inverse = [(yy * x - xy * y) * per_determinant, (xx * y - xy * x) * per_determinant];
        let squared_errors = squares - inverse[0] * x - inverse[1] * y;

        let middle = f64x4::from_slice(simd, &[0.0, 1.0, 2.0, 3.0]) + (self.first + lane as f64);
        let (start, end) = ((middle - REACH as f64).max(0.0), (middle + (REACH + 1) as f64).min(self.len));
        let rays = end - start;
        let incidence = inverse[0] * at(self.directions[0], LONGEST) + inverse[1] * at(self.directions[1], LONGEST);
        let squared_incidence = incidence * incidence / (inverse[0] * inverse[0] + inverse[1] * inverse[1]);
        let squared_noise = self.noise * self.noise;
        let observed = squared_errors / ((rays - 2.0) * squared_noise);
        let excess = (observed - 1.0).max(0.0);
        let mean = observed.max(1.0) / rays;
        let along = |points: &Window<f64>| at(points, LONGEST + REACH) - at(points, LONGEST - REACH);
        let (along_x, along_y) = (along(self.points[0]), along(self.points[1]));
        let spread = squared_incidence * (mean + excess);
        // Variance of the slope of a regression over evenly spaced points.
        let turn = spread * (12.0 * squared_noise) / (along_x * along_x + along_y * along_y);
        let variance = spread + turn * (LEVER * LEVER / squared_noise);
        let is_even = (excess * squared_incidence * squared_noise).simd_lt(ROUGHEST * ROUGHEST);
        let is_surface = is_even & rays.simd_gt(2.0) & variance.simd_lt(f64::INFINITY);
        let variance = is_surface.select(variance, f64x4::splat(simd, f64::INFINITY));
        let doubted = variance + squared_incidence * DOUBT / (rays - 2.0);
        Fit { start, end, inverse, excess, mean, turn, variance, doubted }
    }
}

/// What is kept of the rays on one line.
#[derive(Clone, Copy, Debug, Default)]
struct Stretch<T> {
    /// Index of the ray in the middle, or of the two there.
    middle: T,
    /// One by half the number of rays.
    per_ray: T,
    normal: [T; 2],
    /// m.
    offset: T,
    /// See [`Fit`].
    excess: T,
    /// See [`Fit`].
    mean: T,
    /// See [`Fit`]; infinite where it is no surface.
    turn: T,
}

impl<T: Copy> Stretch<T> {
    fn into_array(self) -> [T; 8] {
        let Self { middle, per_ray, normal, offset, excess, mean, turn } = self;
        [middle, per_ray, normal[0], normal[1], offset, excess, mean, turn]
    }

    fn from_array([middle, per_ray, x, y, offset, excess, mean, turn]: [T; 8]) -> Self {
        Self { middle, per_ray, normal: [x, y], offset, excess, mean, turn }
    }
}

/// Surfaces that rays have met, lane by lane.
#[derive(Clone, Copy)]
struct Met<S: Simd> {
    normal: [f32x8<S>; 2],
    offset: f32x8<S>,
    turn: f32x8<S>,
    /// Variance of a point's distance from it; infinite where there is none.
    variance: f32x8<S>,
}

impl<S: Simd> Met<S> {
    /// The others where they are surer.
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        let surer = other.variance.simd_lt(self.variance);
        let either = |other: f32x8<S>, own: f32x8<S>| surer.select(other, own);
        Self {
            normal: [either(other.normal[0], self.normal[0]), either(other.normal[1], self.normal[1])],
            offset: either(other.offset, self.offset),
            turn: either(other.turn, self.turn),
            variance: either(other.variance, self.variance),
        }
    }

    #[inline(always)]
    fn store(&self, beams: &[usize], surfaces: &mut [Surface]) {
        for (lane, &beam) in beams.iter().enumerate() {
            if self.variance[lane] < f32::INFINITY {
                surfaces[beam] = Surface {
                    normal: [self.normal[0][lane], self.normal[1][lane]],
                    offset: self.offset[lane],
                    variance: self.variance[lane],
                    turn_variance: self.turn[lane],
                };
            }
        }
    }
}

/// Some rays in single precision.
struct Block<S: Simd> {
    index: f32x8<S>,
    direction: [f32x8<S>; 2],
    point: [f32x8<S>; 2],
    /// Standard deviation of a range, m.
    noise: f32,
}

impl<S: Simd> Block<S> {
    /// The surfaces of the stretches that begin at a place in their windows, where they reach up to the rays.
    #[inline(always)]
    fn on(&self, simd: S, stretches: &[&Window<f32>; 8], place: usize) -> Met<S> {
        let at = |field: usize| f32x8::from_slice(simd, &stretches[field][place..place + LANES]);
        let fields = [at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)];
        let Stretch { middle, per_ray, normal, offset, excess, mean, turn } = Stretch::from_array(fields);
        let incidence = normal[0] * self.direction[0] + normal[1] * self.direction[1];
        let squared_incidence = incidence * incidence;
        let error = normal[0] * self.point[0] + normal[1] * self.point[1] - offset;
        let from_middle = (self.index - middle) * per_ray;
        let squared_from_middle = from_middle * from_middle;
        // A regression line is surest in the middle.
        let place = excess + (squared_from_middle * 3.0 + 1.0) * mean;
        #[allow(clippy::cast_possible_truncation)] // to single precision
        let variance = squared_incidence * place + turn * ((LEVER * LEVER) as f32 / (self.noise * self.noise));
        let limit = (excess + 1.0) * squared_incidence * (FARTHEST * FARTHEST * self.noise * self.noise);
        let is_on = squared_from_middle.simd_lt(1.0) & (error * error).simd_le(limit);
        let variance = is_on.select(variance, f32x8::splat(variance.token(), f32::INFINITY));
        Met { normal, offset, turn, variance }
    }
}

/// The numbers of the rays that a window is around.
#[inline(always)]
fn single<S: Simd>(simd: S, window: &Window<f64>) -> f32x8<S> {
    let at = |start: usize| f64x4::from_slice(simd, &window[start..start + HALF]);
    at(LONGEST).narrow(at(LONGEST + HALF))
}

/// Fits lines; keeps the memory that takes.
#[derive(Debug)]
pub(super) struct LineFitter {
    level: Level,
    rays: Rays,
    /// By field of [`Stretch`] and by ray.
    stretches: [Padded<f32>; 8],
}

impl Default for LineFitter {
    fn default() -> Self {
        Self { level: Level::new(), rays: Rays::default(), stretches: Default::default() }
    }
}

impl LineFitter {
    /// The surface at each beam of a scan. `noise`: standard deviation of a range, m.
    pub(super) fn fit(&mut self, scan: &Scan, noise: f64, surfaces: &mut Vec<Surface>) {
        surfaces.clear();
        surfaces.resize(scan.len(), Surface::NONE);
        if scan.valid_len() == 0 {
            return;
        }
        self.rays.set(scan);
        let level = self.level;
        dispatch!(level, simd => self.find_stretches(simd, noise));
        dispatch!(level, simd => self.find_surfaces(simd, noise, surfaces));
    }

    /// The stretch with each ray in its middle that fixes its line best.
    #[inline(always)]
    fn find_stretches<S: Simd>(&mut self, simd: S, noise: f64) {
        let len = self.rays.beams.len();
        for numbers in &mut self.stretches {
            numbers.resize(len);
        }
        for first in (0..len).step_by(LANES) {
            let Rays { directions, points, sums, .. } = &self.rays;
            let sum = |k: usize| sums[k].window(first);
            let around = Around {
                directions: [directions[0].window(first), directions[1].window(first)],
                points: [points[0].window(first), points[1].window(first)],
                sums: [sum(0), sum(1), sum(2), sum(3), sum(4), sum(5)],
                first: first as f64,
                len: len as f64,
                noise,
            };
            let low = around.best(simd, 0).stretch().into_array();
            let high = around.best(simd, HALF).stretch().into_array();
            for field in 0..8 {
                low[field].narrow(high[field]).store_slice(self.stretches[field].block(first));
            }
        }
        self.stretches.iter_mut().for_each(|numbers| numbers.pad(0.0, 0.0));
        let turn = &mut self.stretches[7];
        turn.pad(f32::INFINITY, f32::INFINITY);
    }

    /// The best surface that each ray belongs to: its own stretch's, or a neighbour's.
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // to single precision
    fn find_surfaces<S: Simd>(&self, simd: S, noise: f64, surfaces: &mut [Surface]) {
        for (block, beams) in self.rays.beams.chunks(LANES).enumerate() {
            let first = block * LANES;
            let Rays { directions, points, .. } = &self.rays;
            let rays = Block {
                index: f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + first as f32,
                direction: [single(simd, directions[0].window(first)), single(simd, directions[1].window(first))],
                point: [single(simd, points[0].window(first)), single(simd, points[1].window(first))],
                noise: noise as f32,
            };
            let field = |field: usize| self.stretches[field].window(first);
            let windows = [field(0), field(1), field(2), field(3), field(4), field(5), field(6), field(7)];
            let mut met = rays.on(simd, &windows, LONGEST);
            for neighbour in NEIGHBOURS {
                met = met.or(rays.on(simd, &windows, LONGEST - neighbour)).or(rays.on(simd, &windows, LONGEST + neighbour));
            }
            met.store(beams, surfaces);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// What a laser at the origin sees of a corner of two walls, x = 2 and y = 1.
    fn corner(lone: Option<usize>) -> Scan {
        let beams = BeamGeometry::new(0.0, 1_f64.to_radians(), 91);
        let ranges = beams.directions().iter().enumerate();
        let ranges = ranges.map(|(i, v)| if lone == Some(i) { 0.5 } else { (2.0 / v.x).min(1.0 / v.y) }).collect::<Vec<_>>();
        Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap()
    }

    fn surfaces(scan: &Scan, noise: f64) -> Vec<Surface> {
        let mut surfaces = Vec::new();
        LineFitter::default().fit(scan, noise, &mut surfaces);
        surfaces
    }

    #[test]
    fn walls_are_found_up_to_their_corner() {
        let corner_at = 1.0_f64.atan2(2.0).to_degrees();
        for (i, surface) in surfaces(&corner(None), 1e-4).iter().enumerate() {
            let wall = if (i as f64) < corner_at { ([1.0, 0.0], 2.0) } else { ([0.0, 1.0], 1.0) };
            let near = (0..2).all(|k| (surface.normal[k] - wall.0[k]).abs() < 1e-3) && (surface.offset - wall.1).abs() < 1e-3;
            assert!(near, "{i}: {surface:?}");
        }
    }

    #[test]
    fn a_lone_point_is_no_surface() {
        let surfaces = surfaces(&corner(Some(10)), 0.01);
        assert!(surfaces[10].is_none() && !surfaces[9].is_none() && !surfaces[11].is_none());
    }
}
