//! Cost model of an answer: a setup cost plus a cost per ray and iteration. The iteration count alone does not predict the delay
//! because the first iterations use few rays.

use std::collections::BTreeMap;

use crate::quantile;

/// Cost model of an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationCost {
    /// Delay without any iteration, us.
    pub setup_us: f64,
    /// Delay per ray of an iteration, us.
    pub per_ray_us: f64,
}

/// Medians over all answers with the same number of iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Number of iterations.
    pub iterations: u32,
    /// Median of the rays used, summed over the iterations.
    pub rays: u64,
    /// Median delay, us.
    pub delay_us: f64,
    /// Number of answers.
    pub count: usize,
}

/// Groups answers, given as (iterations, rays, delay in us), by their number of iterations.
pub fn levels(answers: impl IntoIterator<Item = (u32, u64, f64)>) -> Vec<Level> {
    let mut by_iterations: BTreeMap<u32, (Vec<u64>, Vec<f64>)> = BTreeMap::new();
    for (iterations, rays, delay) in answers {
        let (all_rays, delays) = by_iterations.entry(iterations).or_default();
        all_rays.push(rays);
        delays.push(delay);
    }
    let level = |(iterations, (mut rays, mut delays)): (u32, (Vec<u64>, Vec<f64>))| {
        rays.sort_unstable();
        delays.sort_by(f64::total_cmp);
        let (rays, delay_us) = (quantile::of_sorted(&rays, 0.5)?, quantile::of_sorted(&delays, 0.5)?);
        Some(Level { iterations, rays, delay_us, count: delays.len() })
    };
    by_iterations.into_iter().filter_map(level).collect()
}

impl IterationCost {
    /// Expected delay, us. `rays` is summed over the iterations.
    pub fn delay_us(&self, rays: u64) -> f64 {
        self.setup_us + self.per_ray_us * rays as f64
    }
}

/// Fits a line through the levels; `None` if all answers used the same number of rays.
///
/// The slope is the weighted median of the slopes of all pairs of levels (P. K. Sen, JASA 1968), the setup cost is the weighted
/// median of the intercepts. Both are robust against answers that were preempted or ran on cold caches. The weight of a pair is
/// the product of its answer counts and its difference in rays.
pub fn fit(levels: &[Level]) -> Option<IterationCost> {
    let mut slopes = Vec::new();
    for (i, a) in levels.iter().enumerate() {
        for b in &levels[i + 1..] {
            let run = b.rays as f64 - a.rays as f64;
            if run != 0.0 {
                slopes.push(((b.delay_us - a.delay_us) / run, (a.count * b.count) as f64 * run.abs()));
            }
        }
    }
    let per_ray_us = weighted_median(slopes)?;
    let intercept = |level: &Level| (level.delay_us - per_ray_us * level.rays as f64, level.count as f64);
    let setup_us = weighted_median(levels.iter().map(intercept).collect())?;
    Some(IterationCost { setup_us, per_ray_us })
}

/// Weighted median of (value, weight) pairs.
fn weighted_median(mut values: Vec<(f64, f64)>) -> Option<f64> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut below = 0.0;
    values
        .into_iter()
        .find(|(_, weight)| {
            below += weight;
            below >= half
        })
        .map(|(value, _)| value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delayed_answers_do_not_affect_the_fitted_line() {
        let answers = (1..200_u32).map(|i| {
            let iterations = 1 + i % 9;
            let preemption = if i % 7 == 0 { 5000.0 } else { f64::from(i % 3) };
            (iterations, u64::from(100 * iterations), 100.0 + 50.0 * f64::from(iterations) + preemption)
        });
        let cost = fit(&levels(answers)).unwrap();
        assert!((cost.per_ray_us - 0.5).abs() < 0.005 && (cost.setup_us - 101.0).abs() < 3.0, "{cost:?}");
    }

    #[test]
    fn a_line_needs_two_levels() {
        assert_eq!(fit(&levels([(3, 300, 10.0), (3, 300, 11.0)])), None);
        assert_eq!(fit(&[]), None);
    }
}
