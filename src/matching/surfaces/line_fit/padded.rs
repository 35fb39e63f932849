//! Values per ray with padding, so that the ends of a scan need no special treatment.

use super::MAX_REACH;
use crate::matching::surface::LANES;

/// Number of padding values in [`Padded`].
const PADDING: usize = 2 * MAX_REACH + LANES + 1;
/// The values around a block of [`LANES`] rays, as far as stretches reach.
pub(super) type Window<T> = [T; PADDING];

/// One value per ray, or running sums over the preceding rays, padded on both ends as far as stretches reach.
#[derive(Debug, Default)]
pub(super) struct Padded<T>(Vec<T>);

impl<T: Copy + Default> Padded<T> {
    pub(super) fn resize(&mut self, len: usize) {
        self.0.resize(len + PADDING, T::default());
    }

    /// The values without the padding.
    pub(super) fn values(&mut self) -> &mut [T] {
        let end = self.0.len() - PADDING + MAX_REACH;
        &mut self.0[MAX_REACH..end]
    }

    pub(super) fn pad(&mut self, before: T, after: T) {
        let end = self.0.len() - PADDING + MAX_REACH;
        self.0[..MAX_REACH].fill(before);
        self.0[end..].fill(after);
    }

    pub(super) fn repeat_ends(&mut self) {
        let end = self.0.len() - PADDING + MAX_REACH;
        self.pad(self.0[MAX_REACH], self.0[end - 1]);
    }

    /// The block of values that starts at `ray`; it may reach into the padding.
    #[inline(always)]
    pub(super) fn block(&mut self, ray: usize) -> &mut [T] {
        &mut self.0[MAX_REACH + ray..MAX_REACH + ray + LANES]
    }

    /// The values around the block that starts at `ray`.
    #[inline(always)]
    pub(super) fn window(&self, ray: usize) -> &Window<T> {
        // The padding is long enough for every ray.
        self.0[ray..].first_chunk().unwrap_or_else(|| unreachable!())
    }
}
