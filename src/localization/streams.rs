//! Random numbers that do not depend on the thread that draws them: every chunk of particles has its own stream in every step.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

/// Number of particles processed together.
pub(super) const CHUNK: usize = 256;

/// Counts the steps of a filter; each step has its own streams.
#[derive(Clone, Debug)]
pub(super) struct Streams {
    seed: u64,
    step: u64,
}

impl Streams {
    pub(super) fn new(seed: u32) -> Self {
        Self { seed: seed.into(), step: 0 }
    }

    /// Starts the next step.
    pub(super) fn next(&mut self) -> Step {
        self.step += 1;
        Step { key: mix(mix(self.seed) ^ self.step) }
    }
}

/// A step, whose chunks may be processed in any order.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Step {
    key: u64,
}

impl Step {
    /// The random stream of a chunk.
    pub(super) fn stream(self, chunk: usize) -> Pcg64Mcg {
        Pcg64Mcg::seed_from_u64(mix(self.key ^ chunk as u64))
    }
}

/// Mixes the bits of a number so that similar numbers give unrelated ones (`splitmix64`; Steele et al., 2014).
fn mix(number: u64) -> u64 {
    let z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
