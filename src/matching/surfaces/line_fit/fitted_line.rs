//! The line fitted to a stretch, and the surface that it is for a ray.

use fearless_simd::{f32x8, prelude::*};

use super::padded::Window;
use super::summed_rays::RayWindow;
use crate::matching::surface::{LANES, Surfaces};

/// A point is not on a line if it is farther from it than this many standard deviations.
const MAX_SIGMAS: f32 = 3.0;
/// Number of values in a [`FittedLine`].
pub(super) const FIELDS: usize = 7;

/// One fitted line per lane. Variances are in units of the variance of a range.
#[derive(Clone, Copy)]
pub(super) struct FittedLine<S: Simd> {
    /// Index of the middle of the stretch; half-integer if the number of rays is even.
    pub(super) middle: f32x8<S>,
    /// Inverse of half the number of rays.
    pub(super) per_ray: f32x8<S>,
    /// Unit normal.
    pub(super) normal: [f32x8<S>; 2],
    /// Offset, m: `normal . x = offset`.
    pub(super) offset: f32x8<S>,
    /// Mean squared range error about the line.
    pub(super) observed: f32x8<S>,
    /// Variance of the distance of a point from the line that is due to the direction of the line; infinite if it is no surface.
    pub(super) direction_variance: f32x8<S>,
}

impl<S: Simd> FittedLine<S> {
    /// The values in the order in which [`Self::at`] reads them.
    #[inline(always)]
    pub(super) fn values(self) -> [f32x8<S>; FIELDS] {
        let Self { middle, per_ray, normal: [x, y], offset, observed, direction_variance } = self;
        [middle, per_ray, x, y, offset, observed, direction_variance]
    }

    /// The lines from `start` in their windows on.
    #[inline(always)]
    pub(super) fn at(simd: S, lines: &[&Window<f32>; FIELDS], start: usize) -> Self {
        let at = |field: usize| f32x8::from_slice(simd, &lines[field][start..start + LANES]);
        let (normal, direction_variance) = ([at(2), at(3)], at(6));
        Self { middle: at(0), per_ray: at(1), normal, offset: at(4), observed: at(5), direction_variance }
    }

    /// The surfaces that the lines are for the rays of the block, if those lie on them.
    #[inline(always)]
    pub(super) fn surfaces(self, simd: S, rays: &RayWindow<S>) -> Surfaces<S> {
        let Self { middle, per_ray, normal, offset, observed, direction_variance } = self;
        let [direction, point] = rays.block(simd);
        let along = |vector: &[f32x8<S>; 2]| normal[0].mul_add(vector[0], normal[1] * vector[1]);
        let (incidence, error) = (along(&direction), along(&point) - offset);
        let squared_incidence = incidence * incidence;
        let from_middle = (rays.index - middle) * per_ray;
        let squared_from_middle = from_middle * from_middle;
        // A regression line is most certain in its middle.
        let spread = observed.max(1.0);
        let offset_variance = (squared_from_middle * 3.0 + 1.0).mul_add(spread * per_ray * 0.5, spread - 1.0);
        let variance = squared_incidence.mul_add(offset_variance, direction_variance);
        let limit = spread * squared_incidence * (MAX_SIGMAS * MAX_SIGMAS * rays.noise);
        let is_on = squared_from_middle.simd_lt(1.0) & (error * error).simd_le(limit);
        let variance = is_on.select(variance, f32x8::splat(simd, f32::INFINITY));
        Surfaces { normal, offset, variance, direction_variance }
    }
}
