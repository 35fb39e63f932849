//! View consistency: whether the views agree that a ray ends on something static. A ray that only some of them confirm probably
//! ends on something that has moved.

use fearless_simd::{Simd, f32x8, prelude::*};

use crate::matching::surface::LANES;

/// Minimum fraction of the views that is taken to confirm a ray: one that lies on no surface yet may still converge to one.
pub(super) const MIN_CONFIRMED: f32 = 0.02;

/// Consistency of the rays of a block with the views.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewConsistency {
    /// Number of views with a surface for the ray.
    pairs: [f32; LANES],
    /// Number of those views on whose surface the ray ends.
    inliers: [f32; LANES],
    /// Distance from the nearest of these surfaces, m; infinite if there is none.
    pub(super) nearest: [f32; LANES],
    /// Weight of the ray relative to one that all views confirm, from the previous iteration.
    weight: [f32; LANES],
}

impl ViewConsistency {
    /// Initial state: all rays have full weight.
    pub(super) const INITIAL: Self =
        Self { pairs: [0.0; LANES], inliers: [0.0; LANES], nearest: [f32::INFINITY; LANES], weight: [1.0; LANES] };

    /// Resets the weights of all rays to full weight.
    pub(super) fn reset_weights(&mut self) {
        self.weight = [1.0; LANES];
    }

    /// Resets the counts for a new iteration; the weights stay.
    pub(super) fn reset_counts(&mut self) {
        (self.pairs, self.inliers, self.nearest) = ([0.0; LANES], [0.0; LANES], [f32::INFINITY; LANES]);
    }

    /// Number of rays whose nearest surface is nearer than `limit`, m.
    pub(super) fn count_within(&self, limit: f32) -> u32 {
        self.nearest.iter().map(|&distance| u32::from(distance < limit)).sum()
    }

    /// Weights of the rays.
    #[inline(always)]
    pub(super) fn weight<S: Simd>(&self, simd: S) -> f32x8<S> {
        f32x8::from_slice(simd, &self.weight)
    }

    /// Adds the correspondences with one view: `pairs` is 1 if the view has a surface for the ray, `inliers` is 1 if the ray ends
    /// on it, `distance` is the distance from it, m.
    #[inline(always)]
    pub(super) fn add<S: Simd>(&mut self, simd: S, pairs: f32x8<S>, inliers: f32x8<S>, distance: f32x8<S>) {
        let (none, zero) = (f32x8::splat(simd, f32::INFINITY), f32x8::splat(simd, 0.0));
        let distance = pairs.simd_gt(zero).select(distance, none);
        distance.min(f32x8::from_slice(simd, &self.nearest)).store_slice(&mut self.nearest);
        (f32x8::from_slice(simd, &self.pairs) + pairs).store_slice(&mut self.pairs);
        (f32x8::from_slice(simd, &self.inliers) + inliers).store_slice(&mut self.inliers);
    }

    /// Computes the weights for the next iteration: the square root of the fraction of the views that confirm the ray. The square
    /// root, because views may be wrong, too, and a surface that only the latest view has seen may be the only one that
    /// constrains the pose.
    pub(super) fn update_weights(&mut self) {
        for ((pairs, inliers), weight) in self.pairs.iter().zip(&self.inliers).zip(&mut self.weight) {
            *weight = if *pairs > 0.0 { (*inliers / *pairs).max(MIN_CONFIRMED).sqrt() } else { 1.0 };
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // ones, halves and zeros are exact
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    #[inline(always)]
    fn weight_after<S: Simd>(simd: S, views: &[(f32, f32)]) -> f32 {
        let mut consistency = ViewConsistency::INITIAL;
        for &(pairs, inliers) in views {
            let [pairs, inliers, distance] = [pairs, inliers, 1.0 - 0.5 * inliers].map(|value| f32x8::splat(simd, value));
            consistency.add(simd, pairs, inliers, distance);
        }
        consistency.update_weights();
        let nearest =
            views.iter().filter(|(pairs, _)| *pairs > 0.0).map(|(_, inliers)| 1.0 - 0.5 * inliers).fold(f32::INFINITY, f32::min);
        assert_eq!(consistency.nearest, [nearest; LANES]);
        let weight = consistency.weight(simd)[LANES - 1];
        consistency.reset_counts();
        assert_eq!((consistency.pairs, consistency.weight), ([0.0; LANES], [weight; LANES]), "counts restart, the weight stays");
        weight
    }

    #[test]
    fn the_weight_falls_with_the_number_of_views_that_contradict() {
        let weight = |views: &[(f32, f32)]| dispatch!(Level::new(), simd => weight_after(simd, views));
        assert_eq!(weight(&[(1.0, 1.0); 4]), 1.0);
        assert_eq!(weight(&[(1.0, 1.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0)]), 0.5);
        assert_eq!(weight(&[(1.0, 1.0), (0.0, 0.0)]), 1.0, "a view that does not see it does not contradict");
        assert_eq!(weight(&[(0.0, 0.0); 2]), 1.0);
        assert!(weight(&[(1.0, 0.0); 3]) > 0.1, "it may still converge to a surface");
    }
}
