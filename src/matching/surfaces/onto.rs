//! Rays moved onto a view, each with the surface that the view's laser saw in its direction.

use fearless_simd::{Simd, f32x8, prelude::*};

use super::rays::{Block, Lanes, Rays};
use crate::geometry::Pose2;
use crate::matching::surface::{LANES, Surface, Surfaces};
use crate::matching::view::{Bearings, View};

/// A ray agrees roughly with a surface that it ends this near to, m: for poses that are no more than starts.
const ROUGH_AGREEMENT: f32 = 0.12;

/// A pose that moves rays, and the view that it moves them onto.
pub(super) struct Onto<'a> {
    surfaces: &'a [Surface],
    bearings: Bearings,
    cos: f32,
    sin: f32,
    x: f32,
    y: f32,
}

/// A block of rays moved onto a view.
pub(super) struct Moved<S: Simd> {
    /// Where they end in the sensed scan's frame, m.
    pub(super) point: [f32x8<S>; 2],
    /// The same turned into the view's frame, but not shifted.
    pub(super) turned: [f32x8<S>; 2],
    /// What their beams met.
    pub(super) partners: Surfaces<S>,
    /// Signed distance from that, m.
    pub(super) error: f32x8<S>,
}

impl<'a> Onto<'a> {
    #[allow(clippy::cast_possible_truncation)] // to single precision
    pub(super) fn new(view: &'a View, view_from_sensed: &Pose2) -> Self {
        let (sin, cos) = view_from_sensed.theta.sin_cos();
        let [cos, sin, x, y] = [cos, sin, view_from_sensed.x, view_from_sensed.y].map(|v| v as f32);
        Self { surfaces: view.surfaces(), bearings: view.bearings(), cos, sin, x, y }
    }

    /// Which beams look where the rays of a block end.
    #[inline(always)]
    pub(super) fn beams<S: Simd>(&self, simd: S, block: &Block) -> [u32; LANES] {
        let [x, y] = self.turned(simd, &block.point);
        self.bearings.beams(x + self.x, y + self.y)
    }

    /// Vectors of the sensed scan in the view's frame.
    #[inline(always)]
    pub(super) fn turned<S: Simd>(&self, simd: S, [x, y]: &[Lanes; 2]) -> [f32x8<S>; 2] {
        let (x, y) = (f32x8::from_slice(simd, x), f32x8::from_slice(simd, y));
        [x * self.cos - y * self.sin, x * self.sin + y * self.cos]
    }

    /// The rays of a block, each with what its beam met.
    #[inline(always)]
    pub(super) fn pair<S: Simd>(&self, simd: S, block: &Block, beams: &[u32; LANES]) -> Moved<S> {
        let turned = self.turned(simd, &block.point);
        let (x, y) = (turned[0] + self.x, turned[1] + self.y);
        let partners = Surfaces::gather(simd, self.surfaces, beams);
        let [nx, ny] = partners.normal;
        let error = nx.mul_add(x, ny.mul_sub(y, partners.offset));
        Moved { point: block.point.each_ref().map(|lanes| f32x8::from_slice(simd, lanes)), turned, partners, error }
    }

    /// Rays that end near a surface, roughly.
    #[inline(always)]
    pub(super) fn score<S: Simd>(&self, simd: S, rays: &Rays) -> u32 {
        let mut agreeing = 0;
        for block in &rays.blocks {
            let moved = self.pair(simd, block, &self.beams(simd, block));
            let agrees = moved.error.abs().simd_lt(ROUGH_AGREEMENT) & moved.partners.is_some(simd);
            let is_ray = f32x8::from_slice(simd, &block.inverse_square).simd_gt(0.0);
            agreeing += (agrees & is_ray).to_bitmask().count_ones();
        }
        agreeing
    }
}
