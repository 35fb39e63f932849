//! Projective data association: transforms rays into the frame of a view, and looks up the surface that its laser saw in their
//! direction.

use fearless_simd::{Simd, f32x8, prelude::*};

use super::rays::{Block, Rays};
use crate::geometry::Pose2;
use crate::matching::surface::{LANES, Surface, Surfaces};
use crate::matching::view::{Bearings, View};

/// A ray agrees roughly with a surface if it ends within this distance of it, m. Used to score the starts of the search.
const ROUGH_AGREEMENT: f32 = 0.12;

/// A view, and the transform of the sensed rays into its frame.
pub(super) struct ViewProjection<'a> {
    surfaces: &'a [Surface],
    bearings: Bearings,
    cos: f32,
    sin: f32,
    x: f32,
    y: f32,
}

/// A block of rays with the surfaces found for them.
pub(super) struct ProjectedBlock<S: Simd> {
    /// End points in the frame of the sensed scan, m.
    pub(super) point: [f32x8<S>; 2],
    /// End points rotated into the frame of the view, without the translation, m.
    pub(super) rotated: [f32x8<S>; 2],
    /// The surfaces found for them.
    pub(super) surfaces: Surfaces<S>,
    /// Signed distance of the end points from these surfaces, m.
    pub(super) error: f32x8<S>,
}

impl<'a> ViewProjection<'a> {
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision
    pub(super) fn new(view: &'a View, view_from_sensed: &Pose2) -> Self {
        let (sin, cos) = view_from_sensed.theta.sin_cos();
        let [cos, sin, x, y] = [cos, sin, view_from_sensed.x, view_from_sensed.y].map(|v| v as f32);
        Self { surfaces: view.surfaces(), bearings: view.bearings(), cos, sin, x, y }
    }

    /// Beams of the view that point towards the end points of a block.
    #[inline(always)]
    pub(super) fn beams<S: Simd>(&self, simd: S, block: &Block) -> [u32; LANES] {
        let [x, y] = self.rotated(simd, &block.point);
        self.bearings.beams(x + self.x, y + self.y)
    }

    /// Rotates vectors of the sensed scan into the frame of the view.
    #[inline(always)]
    pub(super) fn rotated<S: Simd>(&self, simd: S, [x, y]: &[[f32; LANES]; 2]) -> [f32x8<S>; 2] {
        let (x, y) = (f32x8::from_slice(simd, x), f32x8::from_slice(simd, y));
        [x * self.cos - y * self.sin, x * self.sin + y * self.cos]
    }

    /// Finds the surfaces for the rays of a block. `beams`: the result of [`Self::beams`].
    #[inline(always)]
    pub(super) fn pair<S: Simd>(&self, simd: S, block: &Block, beams: &[u32; LANES]) -> ProjectedBlock<S> {
        let rotated = self.rotated(simd, &block.point);
        let (x, y) = (rotated[0] + self.x, rotated[1] + self.y);
        let surfaces = Surfaces::gather(simd, self.surfaces, beams);
        let [nx, ny] = surfaces.normal;
        let error = nx.mul_add(x, ny.mul_sub(y, surfaces.offset));
        ProjectedBlock { point: block.point.each_ref().map(|lanes| f32x8::from_slice(simd, lanes)), rotated, surfaces, error }
    }

    /// Approximate number of rays that end near a surface.
    #[inline(always)]
    pub(super) fn score<S: Simd>(&self, simd: S, rays: &Rays) -> u32 {
        let mut agreeing = 0;
        for block in &rays.blocks {
            let moved = self.pair(simd, block, &self.beams(simd, block));
            let agrees = moved.error.abs().simd_lt(ROUGH_AGREEMENT) & moved.surfaces.is_some(simd);
            let is_ray = f32x8::from_slice(simd, &block.inverse_square).simd_gt(0.0);
            agreeing += (agrees & is_ray).to_bitmask().count_ones();
        }
        agreeing
    }
}
