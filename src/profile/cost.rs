//! What an answer costs: setup plus so much for every ray of every iteration. Iterations alone do not tell, for the first ones take few
//! rays.

use std::collections::BTreeMap;

use crate::quantile;

/// What an answer costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationCost {
    /// Delay without any iteration, us.
    pub setup_us: f64,
    /// Delay of each ray of an iteration, us.
    pub per_ray_us: f64,
}

/// The answers of so many iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Iterations made.
    pub iterations: u32,
    /// Rays that took part in all of them together, median.
    pub rays: u64,
    /// Median delay, us.
    pub delay_us: f64,
    /// Number of answers.
    pub count: usize,
}

/// The medians for each number of iterations, of (iterations, rays, delay in us).
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
    /// The delay to expect of so many rays in all iterations together, us.
    pub fn delay_us(&self, rays: u64) -> f64 {
        self.setup_us + self.per_ray_us * rays as f64
    }
}

/// The line through the levels; `None` when all answers took as many rays.
///
/// Weighted median of the slopes of all pairs of levels (P. K. Sen, JASA 1968), then of the intercepts: a preempted or cold answer moves
/// neither. A pair weighs as many answers and rays as it spans.
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

/// The value below which half of the weight of (value, weight) lies.
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
    fn finds_the_line_through_answers_of_which_some_were_held_up() {
        let answers = (1..200_u32).map(|i| {
            let iterations = 1 + i % 9;
            let held_up = if i % 7 == 0 { 5000.0 } else { f64::from(i % 3) };
            (iterations, u64::from(100 * iterations), 100.0 + 50.0 * f64::from(iterations) + held_up)
        });
        let cost = fit(&levels(answers)).unwrap();
        assert!((cost.per_ray_us - 0.5).abs() < 0.005 && (cost.setup_us - 101.0).abs() < 3.0, "{cost:?}");
    }

    #[test]
    fn one_level_makes_no_line() {
        assert_eq!(fit(&levels([(3, 300, 10.0), (3, 300, 11.0)])), None);
        assert_eq!(fit(&[]), None);
    }
}
