//! Line fitting: finds the surface at each beam of a scan by fitting a line to a stretch, which is a run of consecutive rays. The
//! line through two neighbouring points would be dominated by their noise.
//!
//! A line `n . x = d` seen from the laser has the inverse range `1/r = (n . v)/d` along the unit vector v. This is linear in
//! `n/d`, so a weighted linear least-squares fit finds it. A range of standard deviation sigma makes an inverse range of standard
//! deviation sigma/r^2, hence the weight r^4. The sums over any stretch are differences of running sums.
//!
//! Of several stretches around a ray, the one that makes the line most certain is chosen. Over a longer stretch the noise
//! averages out, but if the rays do not lie on a line, the residuals exceed the noise and do not average out. A ray near a
//! corner, whose own stretch is short, is assigned to a longer stretch of one of its neighbours.

use fearless_simd::{Level, dispatch, f32x8, f64x4, prelude::*};

use crate::matching::surface::{LANES, Surface, Surfaces};
use crate::quantile::quantile;
use crate::scan::Scan;

/// Rays to either side of the middle of the longest stretch. Each shorter stretch has half as many.
const MAX_REACH: usize = 32;
/// A ray may be assigned to the stretches of the rays at these distances, in rays, to either side.
const NEIGHBOURS: [usize; 6] = [1, 2, 4, 8, 16, MAX_REACH - 1];
/// A point is not on a line if it is farther from it than this many standard deviations.
const MAX_SIGMAS: f32 = 3.0;
/// Maximum unevenness of a surface: standard deviation, m.
const MAX_UNEVENNESS: f32 = 0.1;
/// Lever arm of the direction error of a line, m: points are paired with a surface up to this distance along it from where it was
/// fitted.
const LEVER_ARM: f32 = 0.05;

/// Penalty on short stretches: a few rays may lie on a line by chance, which then seems certain. Stretches are compared as if
/// their total squared error were larger by this many range variances, which hardly matters per ray of a long stretch. With less,
/// noise that is larger than assumed leads to lines through three rays.
const PRIOR_ERROR: f32 = 40.0;

/// Minimum number of rays of a line that is used to estimate the range noise.
const MIN_RAYS: f32 = 32.0;
/// The noise is estimated from the line of every this many rays, because neighbouring lines are nearly the same.
const SAMPLE_STRIDE: usize = 8;
/// Minimum number of such lines for a noise estimate. With fewer, white noise does not average out, and it alone would decide.
const MIN_SAMPLES: usize = 64;

/// Number of rays processed at a time in double precision.
const HALF: usize = LANES / 2;
/// Number of padding values in [`Padded`].
const PADDING: usize = 2 * MAX_REACH + LANES + 1;
/// The values around a block of [`LANES`] rays, as far as stretches reach.
type Window<T> = [T; PADDING];

/// One value per ray, or running sums over the preceding rays, padded on both ends as far as stretches reach. Because of the
/// padding, the ends of the scan need no special treatment.
#[derive(Debug, Default)]
struct Padded<T>(Vec<T>);

impl<T: Copy + Default> Padded<T> {
    fn resize(&mut self, len: usize) -> &mut [T] {
        self.0.resize(len + PADDING, T::default());
        &mut self.0[MAX_REACH..MAX_REACH + len]
    }

    fn pad(&mut self, before: T, after: T) {
        let end = self.0.len() - PADDING + MAX_REACH;
        self.0[..MAX_REACH].fill(before);
        self.0[end..].fill(after);
    }

    fn repeat_ends(&mut self) {
        let end = self.0.len() - PADDING + MAX_REACH;
        self.pad(self.0[MAX_REACH], self.0[end - 1]);
    }

    /// The block of values that starts at `ray`; it may reach into the padding.
    #[inline(always)]
    fn block(&mut self, ray: usize) -> &mut [T] {
        &mut self.0[MAX_REACH + ray..MAX_REACH + ray + LANES]
    }

    #[inline(always)]
    fn window(&self, ray: usize) -> &Window<T> {
        // The padding is long enough for every ray.
        self.0[ray..].first_chunk().unwrap_or_else(|| unreachable!())
    }
}

/// The rays of a scan that have a measurement.
#[derive(Debug, Default)]
struct Rays {
    beams: Vec<u32>,
    /// Ranges, m.
    ranges: Padded<f32>,
    /// Unit vectors along the rays, by coordinate.
    directions: [Padded<f32>; 2],
    /// End points of the rays, by coordinate, m.
    points: [Padded<f32>; 2],
    /// Running sums over the preceding rays: of `w v v'` (xx, xy, yy), `w v / r` (x, y) and `w / r^2`, with `w = r^4`.
    sums: [Padded<f64>; 6],
}

impl Rays {
    /// Copies the measurements of a scan.
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision, and at most 10 000 beams
    fn set(&mut self, scan: &Scan) {
        let len = scan.valid_len();
        self.beams.resize(len, 0);
        let [vx, vy] = self.directions.each_mut().map(|padded| padded.resize(len));
        let measured = self.beams.iter_mut().zip(self.ranges.resize(len)).zip(vx).zip(vy);
        for ((((own_beam, own_range), vx), vy), (beam, direction, range)) in measured.zip(scan.rays()) {
            (*own_beam, *own_range, *vx, *vy) = (beam as u32, range as f32, direction.x as f32, direction.y as f32);
        }
    }

    /// Computes the end points and the running sums.
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
            sums.0[MAX_REACH] = 0.0;
            sums.repeat_ends();
        }
        self.points.iter_mut().for_each(Padded::repeat_ends);
    }
}

/// The sum of each lane and all lanes before it.
#[inline(always)]
fn running_sum<S: Simd>(terms: f64x4<S>) -> f64x4<S> {
    let zero = f64x4::splat(terms.token(), 0.0);
    let pairs = terms + zero.slide::<3>(terms);
    pairs + zero.slide::<2>(pairs)
}

/// One line fit per lane. Variances are in units of the variance of a range.
#[derive(Clone, Copy)]
struct Fit<S: Simd> {
    /// Rays to either side of the middle of the stretch.
    reach: f32x8<S>,
    /// `n/d`.
    inverse: [f32x8<S>; 2],
    /// Mean squared range error about the line.
    observed: f32x8<S>,
    /// See [`FittedLine::direction_variance`].
    direction_variance: f32x8<S>,
    /// Variance of the distance of a point from the line plus the penalty [`PRIOR_ERROR`], for comparisons; infinite if it is no
    /// surface.
    penalized: f32x8<S>,
}

impl<S: Simd> Fit<S> {
    /// Replaces fits by the others where those are more certain.
    #[inline(always)]
    fn or_better(self, other: Self) -> Self {
        let is_better = other.penalized.simd_lt(self.penalized);
        let either = |other: f32x8<S>, own: f32x8<S>| is_better.select(other, own);
        Self {
            reach: either(other.reach, self.reach),
            inverse: [either(other.inverse[0], self.inverse[0]), either(other.inverse[1], self.inverse[1])],
            observed: either(other.observed, self.observed),
            direction_variance: either(other.direction_variance, self.direction_variance),
            penalized: either(other.penalized, self.penalized),
        }
    }
}

/// The neighbourhood of a block of rays.
struct FitWindow<'a, S: Simd> {
    directions: [&'a Window<f32>; 2],
    points: [&'a Window<f32>; 2],
    sums: [&'a Window<f64>; 6],
    /// Indices of the rays.
    index: f32x8<S>,
    /// Total number of rays.
    len: f32,
    /// Variance of a range, m^2.
    noise: f32,
}

impl<S: Simd> FitWindow<'_, S> {
    /// The lines of the most certain stretches that have the rays of the block in their middle.
    #[inline(always)]
    fn best_lines(&self, simd: S) -> FittedLine<f32x8<S>> {
        let fit = self
            .fit::<1>(simd)
            .or_better(self.fit::<2>(simd))
            .or_better(self.fit::<4>(simd))
            .or_better(self.fit::<8>(simd))
            .or_better(self.fit::<16>(simd))
            .or_better(self.fit::<MAX_REACH>(simd));
        let (start, end) = self.ends(fit.reach);
        let [x, y] = fit.inverse;
        let offset = 1.0 / x.mul_add(x, y * y).sqrt();
        let infinite = f32x8::splat(simd, f32::INFINITY);
        FittedLine {
            middle: (start + end - 1.0) * 0.5,
            per_ray: 2.0 / (end - start),
            normal: [x * offset, y * offset],
            offset,
            observed: fit.observed,
            direction_variance: fit.penalized.simd_lt(infinite).select(fit.direction_variance, infinite),
        }
    }

    /// Indices of the first rays of the stretches, and of the rays after their last ones.
    #[inline(always)]
    fn ends(&self, reach: f32x8<S>) -> (f32x8<S>, f32x8<S>) {
        ((self.index - reach).max(0.0), (self.index + reach + 1.0).min(self.len))
    }

    /// For stretches of up to `REACH` rays to either side: the inverse degrees of freedom of the fit (number of rays minus two
    /// parameters), and the inverse number of rays.
    #[inline(always)]
    fn inverse_counts<const REACH: usize>(&self, simd: S) -> (f32x8<S>, f32x8<S>) {
        let (reach, rays) = (REACH as f32, (2 * REACH + 1) as f32);
        if self.index[0] >= reach && self.index[LANES - 1] + reach < self.len {
            return (f32x8::splat(simd, 1.0 / (rays - 2.0)), f32x8::splat(simd, 1.0 / rays));
        }
        let (start, end) = self.ends(f32x8::splat(simd, reach));
        let rays = end - start;
        (1.0 / (rays - 2.0), 1.0 / rays)
    }

    /// Fits lines to the rays up to `REACH` to either side.
    #[inline(always)]
    fn fit<const REACH: usize>(&self, simd: S) -> Fit<S> {
        let (low, high) = (self.solve::<REACH>(simd, 0), self.solve::<REACH>(simd, HALF));
        let both = |k: usize| low[k].narrow(high[k]);
        let (x, y, squared_errors) = (both(0), both(1), both(2));
        let reach = f32x8::splat(simd, REACH as f32);
        let (per_degree_of_freedom, per_ray) = self.inverse_counts::<REACH>(simd);
        let at = |window: &Window<f32>, place: usize| f32x8::from_slice(simd, &window[place..place + LANES]);
        let along = |points: &Window<f32>| at(points, MAX_REACH + REACH) - at(points, MAX_REACH - REACH);
        let (along_x, along_y) = (along(self.points[0]), along(self.points[1]));
        let incidence = x.mul_add(at(self.directions[0], MAX_REACH), y * at(self.directions[1], MAX_REACH));
        // Two quotients with a single division.
        let (square, squared_length) = (x.mul_add(x, y * y), along_x.mul_add(along_x, along_y * along_y));
        let per_both = 1.0 / (square * squared_length);
        let (per_square, per_squared_length) = (squared_length * per_both, square * per_both);

        let squared_incidence = incidence * incidence * per_square;
        let observed = squared_errors * per_degree_of_freedom * self.noise.recip();
        // Unevenness: squared errors beyond those of the noise.
        let excess = (observed - 1.0).max(0.0);
        let spread = squared_incidence * observed.max(1.0).mul_add(per_ray, excess);
        // Variance of the slope of a regression over evenly spaced points, and the variance that it gives a point at the lever
        // arm.
        let direction_variance = spread * (12.0 * LEVER_ARM * LEVER_ARM) * per_squared_length;
        let variance = spread + direction_variance;
        let is_flat = (excess * squared_incidence * self.noise).simd_lt(MAX_UNEVENNESS * MAX_UNEVENNESS);
        let is_surface = is_flat & variance.simd_lt(f32::INFINITY);
        let penalized = (squared_incidence * PRIOR_ERROR).mul_add(per_degree_of_freedom, variance);
        let penalized = is_surface.select(penalized, f32x8::splat(simd, f32::INFINITY));
        Fit { reach, inverse: [x, y], observed, direction_variance, penalized }
    }

    /// Least squares for the half block of rays from `lane` on: `n/d`, and the sum of the squared range errors, m^2. In double
    /// precision, because the sums are differences of large numbers.
    #[inline(always)]
    fn solve<const REACH: usize>(&self, simd: S, lane: usize) -> [f64x4<S>; 3] {
        let at = |window: &Window<f64>, place: usize| f64x4::from_slice(simd, &window[place + lane..place + lane + HALF]);
        let over = |sums: &Window<f64>| at(sums, MAX_REACH + REACH + 1) - at(sums, MAX_REACH - REACH);
        let [xx, xy, yy, x, y, squares] = self.sums;
        let (xx, xy, yy, x, y, squares) = (over(xx), over(xy), over(yy), over(x), over(y), over(squares));
        let per_determinant = 1.0 / xx.mul_sub(yy, xy * xy);
        let inverse = [yy.mul_sub(x, xy * y) * per_determinant, xx.mul_sub(y, xy * x) * per_determinant];
        [inverse[0], inverse[1], squares - inverse[0].mul_add(x, inverse[1] * y)]
    }
}

/// Number of values in a [`FittedLine`].
const FIELDS: usize = 7;

/// The line fitted to a stretch. Variances are in units of the variance of a range.
#[derive(Clone, Copy, Debug, Default)]
struct FittedLine<T> {
    /// Index of the middle of the stretch; half-integer if the number of rays is even.
    middle: T,
    /// Inverse of half the number of rays.
    per_ray: T,
    /// Unit normal.
    normal: [T; 2],
    /// Offset, m: `normal . x = offset`.
    offset: T,
    /// Mean squared range error about the line.
    observed: T,
    /// Variance of the distance of a point from the line that is due to the direction of the line; infinite if it is no surface.
    direction_variance: T,
}

impl<T: Copy> FittedLine<T> {
    #[inline(always)]
    fn into_array(self) -> [T; FIELDS] {
        let Self { middle, per_ray, normal, offset, observed, direction_variance } = self;
        [middle, per_ray, normal[0], normal[1], offset, observed, direction_variance]
    }

    #[inline(always)]
    fn from_array([middle, per_ray, x, y, offset, observed, direction_variance]: [T; FIELDS]) -> Self {
        Self { middle, per_ray, normal: [x, y], offset, observed, direction_variance }
    }
}

/// A block of rays.
struct RayBlock<S: Simd> {
    index: f32x8<S>,
    direction: [f32x8<S>; 2],
    point: [f32x8<S>; 2],
    /// Variance of a range, m^2.
    noise: f32,
}

impl<S: Simd> RayBlock<S> {
    /// The surfaces of the lines from `start` in their windows on, for the rays that lie on them.
    #[inline(always)]
    fn on(&self, simd: S, lines: &[&Window<f32>; FIELDS], start: usize) -> Surfaces<S> {
        let at = |field: usize| f32x8::from_slice(simd, &lines[field][start..start + LANES]);
        let fields = [at(0), at(1), at(2), at(3), at(4), at(5), at(6)];
        let FittedLine { middle, per_ray, normal, offset, observed, direction_variance } = FittedLine::from_array(fields);
        let along = |vector: &[f32x8<S>; 2]| normal[0].mul_add(vector[0], normal[1] * vector[1]);
        let (incidence, error) = (along(&self.direction), along(&self.point) - offset);
        let squared_incidence = incidence * incidence;
        let from_middle = (self.index - middle) * per_ray;
        let squared_from_middle = from_middle * from_middle;
        // A regression line is most certain in its middle.
        let spread = observed.max(1.0);
        let offset_variance = (squared_from_middle * 3.0 + 1.0).mul_add(spread * per_ray * 0.5, spread - 1.0);
        let variance = squared_incidence.mul_add(offset_variance, direction_variance);
        let limit = spread * squared_incidence * (MAX_SIGMAS * MAX_SIGMAS * self.noise);
        let is_on = squared_from_middle.simd_lt(1.0) & (error * error).simd_le(limit);
        let variance = is_on.select(variance, f32x8::splat(simd, f32::INFINITY));
        Surfaces { normal, offset, variance, direction_variance }
    }
}

/// The values of the block that a window is around.
#[inline(always)]
fn middle_block<S: Simd>(simd: S, window: &Window<f32>) -> f32x8<S> {
    f32x8::from_slice(simd, &window[MAX_REACH..MAX_REACH + LANES])
}

/// Indices of the rays of the block that starts at `first`.
#[inline(always)]
fn indices<S: Simd>(simd: S, first: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + first as f32
}

/// Fits lines, and keeps its buffers from scan to scan.
#[derive(Debug)]
pub(super) struct LineFitter {
    level: Level,
    rays: Rays,
    /// The line with each ray in its middle, by field of [`FittedLine`] and by ray.
    lines: [Padded<f32>; FIELDS],
    /// Mean squared range errors of the lines used to estimate the noise.
    errors: Vec<f32>,
}

impl Default for LineFitter {
    fn default() -> Self {
        Self { level: Level::new(), rays: Rays::default(), lines: Default::default(), errors: Vec::new() }
    }
}

impl LineFitter {
    /// Finds the surface at each beam of a scan. `noise`: standard deviation of a range, m.
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision
    pub(super) fn fit(&mut self, scan: &Scan, noise: f64, surfaces: &mut Vec<Surface>) {
        surfaces.clear();
        surfaces.resize(scan.len(), Surface::NONE);
        if scan.valid_len() == 0 {
            return;
        }
        self.rays.set(scan);
        let (level, noise) = (self.level, (noise * noise) as f32);
        dispatch!(level, simd => self.rays.sum(simd));
        dispatch!(level, simd => self.find_lines(simd, noise));
        dispatch!(level, simd => self.find_surfaces(simd, noise, surfaces));
    }

    /// The range variance that the last scan shows, m^2: the median over lines of many rays. `None`: there are too few such
    /// lines. `noise`: the standard deviation that the scan was fitted with, m.
    pub(super) fn observed_variance(&mut self, noise: f64) -> Option<f64> {
        let lines = self.lines.each_ref().map(|numbers| &numbers.0[MAX_REACH..numbers.0.len() + MAX_REACH - PADDING]);
        let [_, per_ray, _, _, _, observed, direction_variance] = lines;
        let sampled = (0..self.rays.beams.len()).step_by(SAMPLE_STRIDE);
        let with_many_rays = sampled.filter(|&ray| per_ray[ray] * MIN_RAYS < 2.0 && direction_variance[ray] < f32::INFINITY);
        self.errors.clear();
        self.errors.extend(with_many_rays.map(|ray| observed[ray]));
        let median = quantile(&mut self.errors, 0.5, f32::total_cmp).filter(|_| self.errors.len() >= MIN_SAMPLES)?;
        Some(f64::from(median) * noise * noise)
    }

    /// Finds the most certain line that has each ray in its middle.
    #[inline(always)]
    fn find_lines<S: Simd>(&mut self, simd: S, noise: f32) {
        let Rays { beams, directions, points, sums, .. } = &self.rays;
        let len = beams.len();
        for numbers in &mut self.lines {
            numbers.resize(len);
        }
        for first in (0..len).step_by(LANES) {
            let sum = |k: usize| sums[k].window(first);
            let window = FitWindow {
                directions: [directions[0].window(first), directions[1].window(first)],
                points: [points[0].window(first), points[1].window(first)],
                sums: [sum(0), sum(1), sum(2), sum(3), sum(4), sum(5)],
                index: indices(simd, first),
                len: len as f32,
                noise,
            };
            for (field, numbers) in window.best_lines(simd).into_array().into_iter().zip(&mut self.lines) {
                field.store_slice(numbers.block(first));
            }
        }
        self.lines.iter_mut().for_each(|numbers| numbers.pad(0.0, 0.0));
        let direction_variance = &mut self.lines[FIELDS - 1];
        direction_variance.pad(f32::INFINITY, f32::INFINITY);
    }

    /// Finds the best surface for each ray: from its own line or that of a neighbour.
    #[inline(always)]
    fn find_surfaces<S: Simd>(&self, simd: S, noise: f32, surfaces: &mut [Surface]) {
        let Rays { beams, directions, points, .. } = &self.rays;
        for (block, beams) in beams.chunks(LANES).enumerate() {
            let first = block * LANES;
            let rays = RayBlock {
                index: indices(simd, first),
                direction: [middle_block(simd, directions[0].window(first)), middle_block(simd, directions[1].window(first))],
                point: [middle_block(simd, points[0].window(first)), middle_block(simd, points[1].window(first))],
                noise,
            };
            let field = |field: usize| self.lines[field].window(first);
            let windows = [field(0), field(1), field(2), field(3), field(4), field(5), field(6)];
            let mut best = rays.on(simd, &windows, MAX_REACH);
            for neighbour in NEIGHBOURS {
                best = best.or_better(rays.on(simd, &windows, MAX_REACH - neighbour)).or_better(rays.on(
                    simd,
                    &windows,
                    MAX_REACH + neighbour,
                ));
            }
            best.direction_variance *= noise / (LEVER_ARM * LEVER_ARM);
            best.scatter(simd, surfaces, beams);
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

    /// Scan, from the origin, of a corner of two walls, x = 2 and y = 1.
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
    fn walls_are_found_up_to_the_corner() {
        let corner_at = 1.0_f64.atan2(2.0).to_degrees();
        for (i, surface) in surfaces(&corner(None), 1e-4).iter().enumerate() {
            let wall = if (i as f64) < corner_at { ([1.0, 0.0], 2.0) } else { ([0.0, 1.0], 1.0) };
            let near = (0..2).all(|k| (surface.normal()[k] - wall.0[k]).abs() < 1e-3) && (surface.offset() - wall.1).abs() < 1e-3;
            assert!(near, "{i}: {surface:?}");
        }
    }

    #[test]
    fn an_isolated_point_is_no_surface() {
        let surfaces = surfaces(&corner(Some(10)), 0.01);
        assert!(surfaces[10].is_none() && !surfaces[9].is_none() && !surfaces[11].is_none());
    }

    /// Scan from the middle of a square room of 10 m. `noise`: standard deviation of the ranges, m.
    fn square_room(beams: usize, noise: f64) -> Scan {
        let beams = BeamGeometry::new(-2.3, 4.6 / beams as f64, beams);
        let (normal, mut random) = (Normal::new(0.0, noise).unwrap(), Pcg64::seed_from_u64(3));
        let range = |v: &Point| 5.0 / v.x.abs().max(v.y.abs()) + normal.sample(&mut random);
        let ranges = beams.directions().iter().map(range).collect::<Vec<_>>();
        Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap()
    }

    #[test]
    fn the_noise_is_estimated_from_lines_of_many_rays() {
        let mut fitter = LineFitter::default();
        for (beams, noise, assumed) in [(1081, 0.02, 0.01), (1081, 0.005, 0.01), (4000, 0.03, 0.03)] {
            fitter.fit(&square_room(beams, noise), assumed, &mut Vec::new());
            let shown = fitter.observed_variance(assumed).unwrap().sqrt();
            assert!((shown / noise - 1.0).abs() < 0.15, "{beams} beams, {noise} m: {shown} m");
        }
        fitter.fit(&square_room(361, 0.02), 0.01, &mut Vec::new());
        assert_eq!(fitter.observed_variance(0.01), None, "too few rays");
    }
}
