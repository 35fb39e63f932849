//! Lines fitted to stretches of a scan: what two neighbouring points say of a wall drowns in their noise, what a whole stretch of it
//! says does not.
//!
//! A line `n . x = d` seen from the laser has the inverse range `1/r = (n . v)/d` along the unit vector v: linear in `n/d`, so that
//! a weighted linear least-squares fit finds it. A range of standard deviation sigma makes an inverse range of sigma/r^2: weight r^4.
//! Sums over any stretch are differences of running sums. Of the stretches around a ray that one is taken which makes the line
//! surest: over a longer one the noise averages out, while what is no line shows as an excess of the residuals over the noise and
//! does not. A ray near a corner, where its own stretch is short, belongs to a longer one of its neighbours.

use fearless_simd::{Level, dispatch, f32x8, f64x4, prelude::*};

use crate::matching::surface::{LANES, Surface, Surfaces};
use crate::quantile::quantile;
use crate::scan::Scan;

/// Rays to either side of its middle that the longest stretch has. The others have half as many as the next longer one.
const LONGEST: usize = 32;
/// A ray may belong to the stretches of the rays so far from it.
const NEIGHBOURS: [usize; 6] = [1, 2, 4, 8, 16, LONGEST - 1];
/// A point farther from a line than this many standard deviations is not on it.
const FARTHEST: f32 = 3.0;
/// What is more uneven is no surface: standard deviation, m.
const ROUGHEST: f32 = 0.1;
/// Points are paired with a surface up to so far along it from the place that it was fitted at, m: the lever of its direction's error.
const LEVER: f32 = 0.05;

/// Few rays lie on a line by chance, and seem sure. Stretches are compared as if they had erred by so much more, in all: of a long one
/// each ray's share is small. With less, noise that is greater than assumed leads to lines through three rays.
const DOUBT: f32 = 40.0;

/// Lines of so many rays show how much ranges err; ...
const TELLING: f32 = 32.0;
/// ... every so manieth is asked, as neighbours say the same; ...
const ASKED: usize = 8;
/// ... and so many must answer. Where there are fewer, white noise does not average out, so that nothing else decides.
const FEWEST_ANSWERS: usize = 64;

/// Rays that are handled at a time in double precision.
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
    #[inline(always)]
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
    beams: Vec<u32>,
    /// m.
    ranges: Padded<f32>,
    /// Unit vectors, by coordinate.
    directions: [Padded<f32>; 2],
    /// Where the rays end, by coordinate, m.
    points: [Padded<f32>; 2],
    /// Sums over the rays before each: of `w v v'` (xx, xy, yy), `w v / r` (x, y) and `w / r^2`, with `w = r^4`.
    sums: [Padded<f64>; 6],
}

impl Rays {
    /// Takes over the measurements.
    #[allow(clippy::cast_possible_truncation)] // to single precision, and at most 10 000 beams
    fn set(&mut self, scan: &Scan) {
        let len = scan.valid_len();
        self.beams.resize(len, 0);
        let [vx, vy] = self.directions.each_mut().map(|padded| padded.resize(len));
        let measured = self.beams.iter_mut().zip(self.ranges.resize(len)).zip(vx).zip(vy);
        for ((((own_beam, own_range), vx), vy), (beam, direction, range)) in measured.zip(scan.rays()) {
            (*own_beam, *own_range, *vx, *vy) = (beam as u32, range as f32, direction.x as f32, direction.y as f32);
        }
    }

    /// Adds up.
    #[inline(always)]
    fn sum<S: Simd>(&mut self, simd: S) {
        let len = self.beams.len();
        for points in &mut self.points {
            points.resize(len);
        }
        for sums in &mut self.sums {
            sums.resize(len + 1);
        }
        let mut before = [f64x4::splat(simd, 0.0); 6];
        for first in (0..len).step_by(LANES) {
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
            sums.0[LONGEST] = 0.0;
            sums.repeat_ends();
        }
        self.points.iter_mut().for_each(Padded::repeat_ends);
    }
}

/// The sum of each lane and all before it.
#[inline(always)]
fn running_sum<S: Simd>(terms: f64x4<S>) -> f64x4<S> {
    let zero = f64x4::splat(terms.token(), 0.0);
    let pairs = terms + zero.slide::<3>(terms);
    pairs + zero.slide::<2>(pairs)
}

/// Rays taken to be on one line each, lane by lane. Variances are in units of the noise's.
#[derive(Clone, Copy)]
struct Fit<S: Simd> {
    /// Rays to either side of the middle.
    reach: f32x8<S>,
    /// `n/d`.
    inverse: [f32x8<S>; 2],
    /// Mean squared range error about the line.
    observed: f32x8<S>,
    /// See [`Stretch`].
    turn: f32x8<S>,
    /// Variance of a point's distance from the line, with [`DOUBT`], to compare; infinite where it is no surface.
    doubted: f32x8<S>,
}

impl<S: Simd> Fit<S> {
    /// The others where they are surer.
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        let surer = other.doubted.simd_lt(self.doubted);
        let either = |other: f32x8<S>, own: f32x8<S>| surer.select(other, own);
        Self {
            reach: either(other.reach, self.reach),
            inverse: [either(other.inverse[0], self.inverse[0]), either(other.inverse[1], self.inverse[1])],
            observed: either(other.observed, self.observed),
            turn: either(other.turn, self.turn),
            doubted: either(other.doubted, self.doubted),
        }
    }
}

/// What is around some rays.
struct Around<'a, S: Simd> {
    directions: [&'a Window<f32>; 2],
    points: [&'a Window<f32>; 2],
    sums: [&'a Window<f64>; 6],
    /// Index of each.
    index: f32x8<S>,
    /// Number of rays in all.
    len: f32,
    /// Variance of a range, m^2.
    noise: f32,
}

impl<S: Simd> Around<'_, S> {
    /// The surest stretches that have the rays in their middles.
    #[inline(always)]
    fn best(&self, simd: S) -> Stretch<f32x8<S>> {
        let fit = self
            .fit::<1>(simd)
            .or(self.fit::<2>(simd))
            .or(self.fit::<4>(simd))
            .or(self.fit::<8>(simd))
            .or(self.fit::<16>(simd))
            .or(self.fit::<LONGEST>(simd));
        let (start, end) = self.ends(fit.reach);
        let [x, y] = fit.inverse;
        let offset = 1.0 / x.mul_add(x, y * y).sqrt();
        let infinite = f32x8::splat(simd, f32::INFINITY);
        Stretch {
            middle: (start + end - 1.0) * 0.5,
            per_ray: 2.0 / (end - start),
            normal: [x * offset, y * offset],
            offset,
            observed: fit.observed,
            turn: fit.doubted.simd_lt(infinite).select(fit.turn, infinite),
        }
    }

    /// Indices of the first rays of stretches, and of those after the last.
    #[inline(always)]
    fn ends(&self, reach: f32x8<S>) -> (f32x8<S>, f32x8<S>) {
        ((self.index - reach).max(0.0), (self.index + reach + 1.0).min(self.len))
    }

    /// One by the rays up to `REACH` to either side that a line's two numbers leave over, and one by all of them.
    #[inline(always)]
    fn shares<const REACH: usize>(&self, simd: S) -> (f32x8<S>, f32x8<S>) {
        let (reach, rays) = (REACH as f32, (2 * REACH + 1) as f32);
        if self.index[0] >= reach && self.index[LANES - 1] + reach < self.len {
            return (f32x8::splat(simd, 1.0 / (rays - 2.0)), f32x8::splat(simd, 1.0 / rays));
        }
        let (start, end) = self.ends(f32x8::splat(simd, reach));
        let rays = end - start;
        (1.0 / (rays - 2.0), 1.0 / rays)
    }

    /// The lines through the rays up to `REACH` to either side.
    #[inline(always)]
    fn fit<const REACH: usize>(&self, simd: S) -> Fit<S> {
        let (low, high) = (self.solve::<REACH>(simd, 0), self.solve::<REACH>(simd, HALF));
        let both = |k: usize| low[k].narrow(high[k]);
        let (x, y, squared_errors) = (both(0), both(1), both(2));
        let reach = f32x8::splat(simd, REACH as f32);
        let (per_spare, per_ray) = self.shares::<REACH>(simd);
        let at = |window: &Window<f32>, place: usize| f32x8::from_slice(simd, &window[place..place + LANES]);
        let along = |points: &Window<f32>| at(points, LONGEST + REACH) - at(points, LONGEST - REACH);
        let (along_x, along_y) = (along(self.points[0]), along(self.points[1]));
        let incidence = x.mul_add(at(self.directions[0], LONGEST), y * at(self.directions[1], LONGEST));
        // Two divisions each for the price of one.
        let (square, squared_length) = (x.mul_add(x, y * y), along_x.mul_add(along_x, along_y * along_y));
        let per_both = 1.0 / (square * squared_length);
        let (per_square, per_squared_length) = (squared_length * per_both, square * per_both);

        let squared_incidence = incidence * incidence * per_square;
        let observed = squared_errors * per_spare * self.noise.recip();
        // What is uneven about the line: squared errors beyond the noise's.
        let excess = (observed - 1.0).max(0.0);
        let spread = squared_incidence * observed.max(1.0).mul_add(per_ray, excess);
        // Variance of the slope of a regression over evenly spaced points; what it makes of a point's at the lever.
        let turn = spread * (12.0 * LEVER * LEVER) * per_squared_length;
        let variance = spread + turn;
        let is_even = (excess * squared_incidence * self.noise).simd_lt(ROUGHEST * ROUGHEST);
        let is_surface = is_even & variance.simd_lt(f32::INFINITY);
        let doubted = (squared_incidence * DOUBT).mul_add(per_spare, variance);
        let doubted = is_surface.select(doubted, f32x8::splat(simd, f32::INFINITY));
        Fit { reach, inverse: [x, y], observed, turn, doubted }
    }

    /// Least squares: `n/d`, and the sum of the squared range errors, m^2, of the half of the rays from `lane` on. Differences of large
    /// numbers.
    #[inline(always)]
    fn solve<const REACH: usize>(&self, simd: S, lane: usize) -> [f64x4<S>; 3] {
        let at = |window: &Window<f64>, place: usize| f64x4::from_slice(simd, &window[place + lane..place + lane + HALF]);
        let over = |sums: &Window<f64>| at(sums, LONGEST + REACH + 1) - at(sums, LONGEST - REACH);
        let [xx, xy, yy, x, y, squares] = self.sums;
        let (xx, xy, yy, x, y, squares) = (over(xx), over(xy), over(yy), over(x), over(y), over(squares));
        let per_determinant = 1.0 / xx.mul_sub(yy, xy * xy);
        let inverse = [yy.mul_sub(x, xy * y) * per_determinant, xx.mul_sub(y, xy * x) * per_determinant];
        [inverse[0], inverse[1], squares - inverse[0].mul_add(x, inverse[1] * y)]
    }
}

/// Numbers of a [`Stretch`].
const FIELDS: usize = 7;

/// What is kept of the rays on one line. Variances are in units of the noise's.
#[derive(Clone, Copy, Debug, Default)]
struct Stretch<T> {
    /// Index of the ray in the middle, or of the two there.
    middle: T,
    /// One by half the number of rays.
    per_ray: T,
    normal: [T; 2],
    /// m.
    offset: T,
    /// Mean squared range error about the line.
    observed: T,
    /// Variance of a point's distance by that of the line's direction; infinite where it is no surface.
    turn: T,
}

impl<T: Copy> Stretch<T> {
    #[inline(always)]
    fn into_array(self) -> [T; FIELDS] {
        let Self { middle, per_ray, normal, offset, observed, turn } = self;
        [middle, per_ray, normal[0], normal[1], offset, observed, turn]
    }

    #[inline(always)]
    fn from_array([middle, per_ray, x, y, offset, observed, turn]: [T; FIELDS]) -> Self {
        Self { middle, per_ray, normal: [x, y], offset, observed, turn }
    }
}

/// Some rays.
struct Block<S: Simd> {
    index: f32x8<S>,
    direction: [f32x8<S>; 2],
    point: [f32x8<S>; 2],
    /// Variance of a range, m^2.
    noise: f32,
}

impl<S: Simd> Block<S> {
    /// The surfaces of the stretches that begin at a place in their windows, where they reach up to the rays.
    #[inline(always)]
    fn on(&self, simd: S, stretches: &[&Window<f32>; FIELDS], place: usize) -> Surfaces<S> {
        let at = |field: usize| f32x8::from_slice(simd, &stretches[field][place..place + LANES]);
        let fields = [at(0), at(1), at(2), at(3), at(4), at(5), at(6)];
        let Stretch { middle, per_ray, normal, offset, observed, turn } = Stretch::from_array(fields);
        let along = |vector: &[f32x8<S>; 2]| normal[0].mul_add(vector[0], normal[1] * vector[1]);
        let (incidence, error) = (along(&self.direction), along(&self.point) - offset);
        let squared_incidence = incidence * incidence;
        let from_middle = (self.index - middle) * per_ray;
        let squared_from_middle = from_middle * from_middle;
        // A regression line is surest in the middle.
        let spread = observed.max(1.0);
        let place = (squared_from_middle * 3.0 + 1.0).mul_add(spread * per_ray * 0.5, spread - 1.0);
        let variance = squared_incidence.mul_add(place, turn);
        let limit = spread * squared_incidence * (FARTHEST * FARTHEST * self.noise);
        let is_on = squared_from_middle.simd_lt(1.0) & (error * error).simd_le(limit);
        let variance = is_on.select(variance, f32x8::splat(simd, f32::INFINITY));
        Surfaces { normal, offset, variance, turn_variance: turn }
    }
}

/// The numbers of the rays that a window is around.
#[inline(always)]
fn here<S: Simd>(simd: S, window: &Window<f32>) -> f32x8<S> {
    f32x8::from_slice(simd, &window[LONGEST..LONGEST + LANES])
}

/// Indices of the rays from one on.
#[inline(always)]
fn indices<S: Simd>(simd: S, first: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + first as f32
}

/// Fits lines; keeps the memory that takes.
#[derive(Debug)]
pub(super) struct LineFitter {
    level: Level,
    rays: Rays,
    /// By field of [`Stretch`] and by ray.
    stretches: [Padded<f32>; FIELDS],
    /// Squared range errors about some of the lines.
    errors: Vec<f32>,
}

impl Default for LineFitter {
    fn default() -> Self {
        Self { level: Level::new(), rays: Rays::default(), stretches: Default::default(), errors: Vec::new() }
    }
}

impl LineFitter {
    /// The surface at each beam of a scan. `noise`: standard deviation of a range, m.
    #[allow(clippy::cast_possible_truncation)] // to single precision
    pub(super) fn fit(&mut self, scan: &Scan, noise: f64, surfaces: &mut Vec<Surface>) {
        surfaces.clear();
        surfaces.resize(scan.len(), Surface::NONE);
        if scan.valid_len() == 0 {
            return;
        }
        self.rays.set(scan);
        let (level, noise) = (self.level, (noise * noise) as f32);
        dispatch!(level, simd => self.rays.sum(simd));
        dispatch!(level, simd => self.find_stretches(simd, noise));
        dispatch!(level, simd => self.find_surfaces(simd, noise, surfaces));
    }

    /// The variance of a range that the last scan showed, m^2: the median over lines of many rays. `None`: there are few such lines.
    /// `noise`: what it was fitted with.
    pub(super) fn shown_variance(&mut self, noise: f64) -> Option<f64> {
        let stretches = self.stretches.each_ref().map(|numbers| &numbers.0[LONGEST..numbers.0.len() + LONGEST - PADDING]);
        let [_, per_ray, _, _, _, observed, turn] = stretches;
        let some = (0..self.rays.beams.len()).step_by(ASKED);
        let telling = some.filter(|&ray| per_ray[ray] * TELLING < 2.0 && turn[ray] < f32::INFINITY);
        self.errors.clear();
        self.errors.extend(telling.map(|ray| observed[ray]));
        let median = quantile(&mut self.errors, 0.5, f32::total_cmp).filter(|_| self.errors.len() >= FEWEST_ANSWERS)?;
        Some(f64::from(median) * noise * noise)
    }

    /// The stretch with each ray in its middle that fixes its line best.
    #[inline(always)]
    fn find_stretches<S: Simd>(&mut self, simd: S, noise: f32) {
        let Rays { beams, directions, points, sums, .. } = &self.rays;
        let len = beams.len();
        for numbers in &mut self.stretches {
            numbers.resize(len);
        }
        for first in (0..len).step_by(LANES) {
            let sum = |k: usize| sums[k].window(first);
            let around = Around {
                directions: [directions[0].window(first), directions[1].window(first)],
                points: [points[0].window(first), points[1].window(first)],
                sums: [sum(0), sum(1), sum(2), sum(3), sum(4), sum(5)],
                index: indices(simd, first),
                len: len as f32,
                noise,
            };
            for (field, numbers) in around.best(simd).into_array().into_iter().zip(&mut self.stretches) {
                field.store_slice(numbers.block(first));
            }
        }
        self.stretches.iter_mut().for_each(|numbers| numbers.pad(0.0, 0.0));
        let turn = &mut self.stretches[FIELDS - 1];
        turn.pad(f32::INFINITY, f32::INFINITY);
    }

    /// The best surface that each ray belongs to: its own stretch's, or a neighbour's.
    #[inline(always)]
    fn find_surfaces<S: Simd>(&self, simd: S, noise: f32, surfaces: &mut [Surface]) {
        let Rays { beams, directions, points, .. } = &self.rays;
        for (block, beams) in beams.chunks(LANES).enumerate() {
            let first = block * LANES;
            let rays = Block {
                index: indices(simd, first),
                direction: [here(simd, directions[0].window(first)), here(simd, directions[1].window(first))],
                point: [here(simd, points[0].window(first)), here(simd, points[1].window(first))],
                noise,
            };
            let field = |field: usize| self.stretches[field].window(first);
            let windows = [field(0), field(1), field(2), field(3), field(4), field(5), field(6)];
            let mut met = rays.on(simd, &windows, LONGEST);
            for neighbour in NEIGHBOURS {
                met = met.or(rays.on(simd, &windows, LONGEST - neighbour)).or(rays.on(simd, &windows, LONGEST + neighbour));
            }
            met.turn_variance *= noise / (LEVER * LEVER);
            met.scatter(simd, surfaces, beams);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::geometry::Point;
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
            let near = (0..2).all(|k| (surface.normal()[k] - wall.0[k]).abs() < 1e-3) && (surface.offset() - wall.1).abs() < 1e-3;
            assert!(near, "{i}: {surface:?}");
        }
    }

    #[test]
    fn a_lone_point_is_no_surface() {
        let surfaces = surfaces(&corner(Some(10)), 0.01);
        assert!(surfaces[10].is_none() && !surfaces[9].is_none() && !surfaces[11].is_none());
    }

    /// What a laser in the middle of a square room of 10 m sees; standard deviation of the ranges, m.
    fn square_room(beams: usize, noise: f64) -> Scan {
        let beams = BeamGeometry::new(-2.3, 4.6 / beams as f64, beams);
        let (normal, mut random) = (Normal::new(0.0, noise).unwrap(), Pcg64::seed_from_u64(3));
        let range = |v: &Point| 5.0 / v.x.abs().max(v.y.abs()) + normal.sample(&mut random);
        let ranges = beams.directions().iter().map(range).collect::<Vec<_>>();
        Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap()
    }

    #[test]
    fn lines_of_many_rays_show_the_noise() {
        let mut fitter = LineFitter::default();
        for (beams, noise, assumed) in [(1081, 0.02, 0.01), (1081, 0.005, 0.01), (4000, 0.03, 0.03)] {
            fitter.fit(&square_room(beams, noise), assumed, &mut Vec::new());
            let shown = fitter.shown_variance(assumed).unwrap().sqrt();
            assert!((shown / noise - 1.0).abs() < 0.15, "{beams} beams, {noise} m: {shown} m");
        }
        fitter.fit(&square_room(361, 0.02), 0.01, &mut Vec::new());
        assert_eq!(fitter.shown_variance(0.01), None, "too few rays");
    }
}
