//! Line fits to stretches of rays.

use fearless_simd::{f32x8, f64x4, prelude::*};

use super::fitted_line::FittedLine;
use super::padded::Window;
use super::summed_rays::RayWindow;
use super::{HALF, LEVER_ARM, MAX_REACH};
use crate::matching::surface::LANES;

/// Maximum unevenness of a surface: standard deviation, m.
const MAX_UNEVENNESS: f32 = 0.1;
/// Penalty on short stretches: a few rays may lie on a line by chance, which then seems certain. Stretches are compared as if
/// their total squared error were larger by this many range variances, which hardly matters per ray of a long stretch. With less,
/// noise that is larger than assumed leads to lines through three rays.
const PRIOR_ERROR: f32 = 40.0;

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

impl<S: Simd> RayWindow<'_, S> {
    /// The lines of the most certain stretches that have the rays of the block in their middle.
    #[inline(always)]
    pub(super) fn best_lines(&self, simd: S) -> FittedLine<S> {
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
        let at = |points: &Window<f32>, place: usize| f32x8::from_slice(simd, &points[place..place + LANES]);
        let along = |points: &Window<f32>| at(points, MAX_REACH + REACH) - at(points, MAX_REACH - REACH);
        let (along_x, along_y) = (along(self.points[0]), along(self.points[1]));
        let [[vx, vy], _] = self.block(simd);
        let incidence = x.mul_add(vx, y * vy);
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
