//! The surfaces that beams hit: packed in memory, eight at a time in SIMD registers.

use fearless_simd::{Simd, f32x4, f32x8, mask32x8, prelude::*, u32x8};

/// Number of surfaces processed at a time.
pub(super) const LANES: usize = 8;
/// Variance that marks the absence of a surface, a power of two: its weight is practically zero.
const NO_VARIANCE: f32 = (1_u64 << 40) as f32;
/// The bits of the variance that packing keeps.
const VARIANCE_MASK: u32 = 0xffff_0000;
/// Packing shifts the direction variance right by this many bits.
pub(super) const DIRECTION_SHIFT: u32 = 16;

/// The line that a beam hit, in the frame of the laser: unit normal, offset (m) and two variances packed in one number. Single
/// precision resolves micrometres. The variances need two or three digits, so only the upper 16 bits of each are kept, and a
/// surface is a single load of 16 bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface([f32; 4]);

impl Surface {
    /// No surface: no measurement, a corner or an isolated point.
    pub(super) const NONE: Self = Self([0.0, 0.0, 0.0, NO_VARIANCE]);

    pub(super) fn is_none(&self) -> bool {
        self.variance() >= NO_VARIANCE
    }

    /// Unit normal.
    pub(super) fn normal(&self) -> [f32; 2] {
        [self.0[0], self.0[1]]
    }

    /// Offset of the line, m: `normal . x = offset` for its points x.
    pub(super) fn offset(&self) -> f32 {
        self.0[2]
    }

    /// See [`Surfaces::variance`].
    pub(super) fn variance(&self) -> f32 {
        self.0[3] // the bits of the direction variance are too small to matter
    }
}

/// Eight surfaces, one per SIMD lane.
#[derive(Clone, Copy)]
pub(super) struct Surfaces<S: Simd> {
    pub(super) normal: [f32x8<S>; 2],
    pub(super) offset: f32x8<S>,
    /// Variance of the distance of a point from the line, without the noise of the point itself, in units of the variance of a
    /// range.
    pub(super) variance: f32x8<S>,
    /// Variance of the line's direction, rad^2.
    pub(super) direction_variance: f32x8<S>,
}

impl<S: Simd> Surfaces<S> {
    /// Loads the surfaces of the given beams.
    #[inline(always)]
    pub(super) fn gather(simd: S, surfaces: &[Surface], beams: &[u32; LANES]) -> Self {
        let row = |lane: usize| f32x4::from_slice(simd, &surfaces[beams[lane] as usize].0);
        let low = transpose([row(0), row(1), row(2), row(3)]);
        let high = transpose([row(4), row(5), row(6), row(7)]);
        let column = |k: usize| low[k].combine(high[k]);
        let variance = column(3);
        let direction_variance = (variance.bitcast::<u32x8<S>>() << DIRECTION_SHIFT).bitcast();
        Self { normal: [column(0), column(1)], offset: column(2), variance, direction_variance }
    }

    /// Stores the surfaces at the given beams; those with infinite variance are stored as [`Surface::NONE`].
    #[inline(always)]
    pub(super) fn scatter(&self, simd: S, surfaces: &mut [Surface], beams: &[u32]) {
        let is_some = self.is_some(simd);
        let or_zero = |value: f32x8<S>| is_some.select(value, f32x8::splat(simd, 0.0)).split();
        let bits = |value: f32x8<S>| value.bitcast::<u32x8<S>>();
        let packed = (bits(self.variance) & VARIANCE_MASK) | (bits(self.direction_variance) >> DIRECTION_SHIFT);
        let packed = is_some.select(packed.bitcast(), f32x8::splat(simd, NO_VARIANCE)).split();
        let columns = [or_zero(self.normal[0]), or_zero(self.normal[1]), or_zero(self.offset), packed];
        let [(a, e), (b, f), (c, g), (d, h)] = columns;
        let ([a, b, c, d], [e, f, g, h]) = (transpose([a, b, c, d]), transpose([e, f, g, h]));
        for (&beam, row) in beams.iter().zip([a, b, c, d, e, f, g, h]) {
            row.store_slice(&mut surfaces[beam as usize].0);
        }
    }

    /// Mask of the lanes that hold a surface.
    #[inline(always)]
    pub(super) fn is_some(&self, simd: S) -> mask32x8<S> {
        self.variance.simd_lt(f32x8::splat(simd, NO_VARIANCE))
    }

    /// Replaces surfaces by the others where those have a smaller variance.
    #[inline(always)]
    pub(super) fn or_better(self, other: Self) -> Self {
        let is_better = other.variance.simd_lt(self.variance);
        let either = |other: f32x8<S>, own: f32x8<S>| is_better.select(other, own);
        Self {
            normal: [either(other.normal[0], self.normal[0]), either(other.normal[1], self.normal[1])],
            offset: either(other.offset, self.offset),
            variance: either(other.variance, self.variance),
            direction_variance: either(other.direction_variance, self.direction_variance),
        }
    }
}

/// Transposes a 4x4 matrix.
#[inline(always)]
fn transpose<S: Simd>([a, b, c, d]: [f32x4<S>; 4]) -> [f32x4<S>; 4] {
    let (ac_low, bd_low) = (a.zip_low(c), b.zip_low(d));
    let (ac_high, bd_high) = (a.zip_high(c), b.zip_high(d));
    [ac_low.zip_low(bd_low), ac_low.zip_high(bd_low), ac_high.zip_low(bd_high), ac_high.zip_high(bd_high)]
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    #[inline(always)]
    fn scattered<S: Simd>(simd: S, variance: &[f32; LANES]) -> Vec<Surface> {
        let lanes = |start: f32| f32x8::from_slice(simd, &std::array::from_fn::<_, LANES, _>(|i| start + i as f32));
        let direction_variance = f32x8::splat(simd, 3e-5);
        let variance = f32x8::from_slice(simd, variance);
        let all = Surfaces { normal: [lanes(0.0), lanes(10.0)], offset: lanes(20.0), variance, direction_variance };
        let mut surfaces = vec![Surface::NONE; 9];
        all.scatter(simd, &mut surfaces, &[8, 7, 6, 5, 4, 3, 2]);
        let back = Surfaces::gather(simd, &surfaces, &[8, 7, 6, 5, 4, 3, 2, 1]);
        assert!((back.direction_variance[1] - 3e-5).abs() < 3e-7 && (back.variance[1] - variance[1]).abs() < 0.01 * variance[1]);
        surfaces
    }

    #[test]
    fn packing_keeps_enough_digits() {
        let variance = [0.1, 0.22, 30.0, f32::INFINITY, 5.0, 6.0, 7.0, 8.0];
        let surfaces = dispatch!(Level::new(), simd => scattered(simd, &variance));
        let is_some: Vec<bool> = surfaces.iter().map(|surface| !surface.is_none()).collect();
        assert_eq!(is_some, [false, false, true, true, true, false, true, true, true]);
        assert_eq!(surfaces[7].0[..3], [1.0, 11.0, 21.0]);
        assert!((surfaces[7].variance() - 0.22).abs() < 0.002);
    }
}
