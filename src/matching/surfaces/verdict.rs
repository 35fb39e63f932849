//! What several views together say of a ray: that it ends on something that stands, or on what has moved.

use fearless_simd::{Simd, f32x8, prelude::*};

use super::rays::Lanes;
use crate::matching::surface::LANES;

/// Part of the views at least that a ray counts as confirmed by: one that lies on no surface may still come to.
const LEAST_CONFIRMED: f32 = 0.02;

/// How the views judge the rays of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Verdict {
    /// Views that have a surface for the ray.
    pairs: Lanes,
    /// Of those, the ones that it lies on it in.
    inliers: Lanes,
    /// Distance from the nearest of those surfaces, m; infinite where there is none.
    pub(super) nearest: Lanes,
    /// By the pairs before, what the ray weighs in comparison with one that all views confirm.
    credit: Lanes,
}

impl Verdict {
    /// Nothing is known against any ray.
    pub(super) const NONE: Self =
        Self { pairs: [0.0; LANES], inliers: [0.0; LANES], nearest: [f32::INFINITY; LANES], credit: [1.0; LANES] };

    /// Nothing is known against them any more.
    pub(super) fn forget(&mut self) {
        self.credit = [1.0; LANES];
    }

    /// Begins to count the views of other pairs.
    pub(super) fn begin(&mut self) {
        (self.pairs, self.inliers, self.nearest) = ([0.0; LANES], [0.0; LANES], [f32::INFINITY; LANES]);
    }

    /// Rays whose nearest surface is nearer than `limit`, m.
    pub(super) fn within(&self, limit: f32) -> u32 {
        self.nearest.iter().map(|&distance| u32::from(distance < limit)).sum()
    }

    /// The credit of the rays.
    #[inline(always)]
    pub(super) fn credit<S: Simd>(&self, simd: S) -> f32x8<S> {
        f32x8::from_slice(simd, &self.credit)
    }

    /// Takes note of what one view says: ones where it has a surface, ones where the ray lies on it, and the distance from it, m.
    #[inline(always)]
    pub(super) fn add<S: Simd>(&mut self, simd: S, pairs: f32x8<S>, inliers: f32x8<S>, distance: f32x8<S>) {
        let (none, zero) = (f32x8::splat(simd, f32::INFINITY), f32x8::splat(simd, 0.0));
        let distance = pairs.simd_gt(zero).select(distance, none);
        distance.min(f32x8::from_slice(simd, &self.nearest)).store_slice(&mut self.nearest);
        (f32x8::from_slice(simd, &self.pairs) + pairs).store_slice(&mut self.pairs);
        (f32x8::from_slice(simd, &self.inliers) + inliers).store_slice(&mut self.inliers);
    }

    /// Gives credit for the next pairs. The root, because views may err too, and what only the last one has seen may yet be the only thing
    /// that tells where the robot is.
    pub(super) fn conclude(&mut self) {
        for ((pairs, inliers), credit) in self.pairs.iter().zip(&self.inliers).zip(&mut self.credit) {
            *credit = if *pairs > 0.0 { (*inliers / *pairs).max(LEAST_CONFIRMED).sqrt() } else { 1.0 };
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // ones, halves and zeros are exact
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    #[inline(always)]
    fn judged<S: Simd>(simd: S, views: &[(f32, f32)]) -> f32 {
        let mut verdict = Verdict::NONE;
        for &(pairs, inliers) in views {
            let [pairs, inliers, distance] = [pairs, inliers, 1.0 - 0.5 * inliers].map(|value| f32x8::splat(simd, value));
            verdict.add(simd, pairs, inliers, distance);
        }
        verdict.conclude();
        let nearest =
            views.iter().filter(|(pairs, _)| *pairs > 0.0).map(|(_, inliers)| 1.0 - 0.5 * inliers).fold(f32::INFINITY, f32::min);
        assert_eq!(verdict.nearest, [nearest; LANES]);
        let credit = verdict.credit(simd)[LANES - 1];
        verdict.begin();
        assert_eq!(
            (verdict.pairs, verdict.credit),
            ([0.0; LANES], [credit; LANES]),
            "the next pairs are counted anew, with this credit"
        );
        credit
    }

    #[test]
    fn credit_falls_with_the_views_that_contradict() {
        let credit = |views: &[(f32, f32)]| dispatch!(Level::new(), simd => judged(simd, views));
        assert_eq!(credit(&[(1.0, 1.0); 4]), 1.0);
        assert_eq!(credit(&[(1.0, 1.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0)]), 0.5);
        assert_eq!(credit(&[(1.0, 1.0), (0.0, 0.0)]), 1.0, "who does not see it does not contradict");
        assert_eq!(credit(&[(0.0, 0.0); 2]), 1.0);
        assert!(credit(&[(1.0, 0.0); 3]) > 0.1, "it may come to lie on one yet");
    }
}
