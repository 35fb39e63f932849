//! Outlier rejection for classic correspondences, in linear time.

use super::correspondence::Nearest;
use crate::quantile::quantile;

/// A correspondence: a sensed point and its partner in the reference scan.
#[derive(Clone, Copy, Debug)]
pub struct Correspondence {
    /// Index of the sensed point.
    pub sensed: u32,
    /// Index of the nearest reference ray.
    pub ray: u32,
    /// Index of the reference segment, which is that of its first ray.
    pub segment: u32,
    /// Squared error in the metric of the solver, m^2.
    pub squared_error: f64,
}

crate::knobs! {
    /// How outliers are rejected from classic correspondences.
    pub struct RejectionKnobs {
        /// If several sensed points have the same nearest reference point, keep only the nearest of them.
        remove_duplicates: bool = true;
        /// Fraction of the correspondences to keep, those with the smallest errors (trimming).
        trim_percentile: f64 = 0.98, in 0.1 to 1;
        /// Adaptive trimming: the maximum error is the error at this percentile times `adaptive_multiplier`.
        adaptive_percentile: f64 = 0.7, in 0.1 to 1;
        /// See `adaptive_percentile`.
        adaptive_multiplier: f64 = 6.0, in 1 to 1000;
    }
}

/// Outlier rejection with its buffers.
#[derive(Debug, Default)]
pub(super) struct Rejection {
    knobs: RejectionKnobs,
    nearest_of_ray: Vec<f64>,
    errors: Vec<f64>,
}

impl Rejection {
    pub(super) fn new(knobs: RejectionKnobs) -> Self {
        Self { knobs, ..Self::default() }
    }

    /// Removes the outliers from `pairs`. `nearest` gives the distance of each sensed point from its nearest reference point.
    pub(super) fn apply(&mut self, pairs: &mut Vec<Correspondence>, nearest: &[Nearest], reference_rays: usize) {
        if self.knobs.remove_duplicates {
            self.remove_duplicates(pairs, nearest, reference_rays);
        }
        self.trim(pairs);
    }

    fn remove_duplicates(&mut self, pairs: &mut Vec<Correspondence>, nearest: &[Nearest], reference_rays: usize) {
        let distance = |pair: &Correspondence| nearest[pair.sensed as usize].squared_distance;
        self.nearest_of_ray.clear();
        self.nearest_of_ray.resize(reference_rays, f64::INFINITY);
        for pair in &*pairs {
            let least = &mut self.nearest_of_ray[pair.ray as usize];
            *least = least.min(distance(pair));
        }
        pairs.retain(|pair| distance(pair) <= self.nearest_of_ray[pair.ray as usize]);
    }

    fn trim(&mut self, pairs: &mut Vec<Correspondence>) {
        self.errors.clear();
        self.errors.extend(pairs.iter().map(|pair| pair.squared_error));
        let multiplier = self.knobs.adaptive_multiplier * self.knobs.adaptive_multiplier;
        let mut error_at = |fraction: f64| quantile(&mut self.errors, fraction, f64::total_cmp);
        let trimmed = error_at(self.knobs.trim_percentile);
        let (Some(trimmed), Some(bulk)) = (trimmed, error_at(self.knobs.adaptive_percentile)) else { return };
        let limit = trimmed.min(multiplier * bulk);
        pairs.retain(|pair| pair.squared_error <= limit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(sensed: u32, ray: u32, squared_error: f64) -> Correspondence {
        Correspondence { sensed, ray, segment: ray, squared_error }
    }

    fn kept(knobs: RejectionKnobs, pairs: &[Correspondence]) -> Vec<u32> {
        let nearest: Vec<_> = pairs.iter().map(|p| Nearest { ray: p.ray, squared_distance: p.squared_error }).collect();
        let mut pairs = pairs.to_vec();
        Rejection::new(knobs).apply(&mut pairs, &nearest, 100);
        pairs.iter().map(|p| p.sensed).collect()
    }

    #[test]
    fn the_nearest_of_duplicates_is_kept() {
        let knobs = RejectionKnobs { trim_percentile: 1.0, adaptive_multiplier: 1000.0, ..RejectionKnobs::default() };
        let pairs = [pair(0, 7, 0.3), pair(1, 7, 0.1), pair(2, 8, 0.2)];
        assert_eq!(kept(knobs.clone(), &pairs), [1, 2]);
        assert_eq!(kept(RejectionKnobs { remove_duplicates: false, ..knobs }, &pairs), [0, 1, 2]);
    }

    #[test]
    fn trimming_keeps_the_percentile() {
        let knobs = RejectionKnobs { trim_percentile: 0.9, adaptive_multiplier: 1000.0, ..RejectionKnobs::default() };
        let pairs: Vec<_> = (0..20).map(|i| pair(i, i, f64::from(20 - i))).collect();
        assert_eq!(kept(knobs, &pairs), (2..20).collect::<Vec<_>>());
    }

    #[test]
    fn the_adaptive_limit_rejects_errors_far_above_those_of_the_bulk() {
        let knobs = RejectionKnobs {
            trim_percentile: 1.0,
            adaptive_percentile: 0.5,
            adaptive_multiplier: 2.0,
            ..RejectionKnobs::default()
        };
        let pairs: Vec<_> = [1.0, 1.0, 1.0, 3.9, 4.1].iter().enumerate().map(|(i, &e)| pair(i as u32, i as u32, e)).collect();
        assert_eq!(kept(knobs, &pairs), [0, 1, 2, 3]);
    }
}
