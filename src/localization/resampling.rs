//! Resampling: which particles are kept, and how many.

use std::collections::HashSet;

use super::particles::{Particles, bin_of};

/// Size of the bins of KLD sampling: m, rad.
const BIN_SIZE: (f32, f32) = (0.5, 0.175);
/// Upper 1 % quantile of the normal distribution.
const QUANTILE: f64 = 2.326;

/// Low-variance resampling: `count` indices, each as often as its weight requires, within one. `start` is random in [0, 1).
pub(super) fn low_variance(weights: &[f32], count: usize, start: f64) -> impl Iterator<Item = usize> {
    let total: f64 = weights.iter().map(|&weight| f64::from(weight)).sum();
    let step = total / count as f64;
    let (mut index, mut sum) = (0, weights.first().map_or(0.0, |&weight| f64::from(weight)));
    (0..count).map(move |k| {
        let target = (k as f64 + start) * step;
        while sum < target && index + 1 < weights.len() {
            index += 1;
            sum += f64::from(weights[index]);
        }
        index
    })
}

/// Number of particles needed to represent the distribution of those at `chosen` with an error of at most `error`, with 99 %
/// probability (Fox, 2003).
pub(super) fn kld_count(particles: &Particles, chosen: impl Iterator<Item = usize>, resolution: f32, error: f64) -> usize {
    let mut bins = HashSet::new();
    let mut last = usize::MAX;
    for index in chosen {
        if index != last {
            bins.insert(bin_of(particles.pose(index), resolution, BIN_SIZE));
        }
        last = index;
    }
    let k = bins.len().saturating_sub(1).max(1) as f64;
    let term = 2.0 / (9.0 * k);
    (k / (2.0 * error) * (1.0 - term + term.sqrt() * QUANTILE).powi(3)).ceil() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn each_particle_is_chosen_as_often_as_its_weight_requires(weights in prop::collection::vec(0.01_f32..1.0, 1..50), count in 1_usize..200, start in 0.0..1.0) {
            let chosen: Vec<usize> = low_variance(&weights, count, start).collect();
            let total: f32 = weights.iter().sum();
            prop_assert_eq!(chosen.len(), count);
            for (index, weight) in weights.iter().enumerate() {
                let times = chosen.iter().filter(|&&chosen| chosen == index).count() as f32;
                prop_assert!((times - weight / total * count as f32).abs() < 1.01);
            }
        }
    }

    #[test]
    fn a_wider_cloud_needs_more_particles() {
        let mut particles = Particles::default();
        (0..100).for_each(|i| particles.push([i as f32 * 20.0, 0.0, 0.0], 0.0, 0.0));
        let few = kld_count(&particles, 0..2, 0.05, 0.05);
        let many = kld_count(&particles, 0..100, 0.05, 0.05);
        assert!((40..100).contains(&few) && (1200..1600).contains(&many), "{few} {many}");
    }
}
