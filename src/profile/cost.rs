//! Delay against iterations: a line through the medians, setup plus so much per iteration.

use std::collections::BTreeMap;

use crate::evaluation::statistics::percentile;

/// What an answer costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationCost {
    /// Delay without any iteration, us.
    pub setup_us: f64,
    /// Delay of each iteration, us.
    pub per_iteration_us: f64,
}

/// The answers of so many iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Iterations made.
    pub iterations: u32,
    /// Median delay, us.
    pub delay_us: f64,
    /// Number of answers.
    pub count: usize,
}

/// The median delay for each number of iterations, of (iterations, delay in us).
pub fn levels(answers: impl IntoIterator<Item = (u32, f64)>) -> Vec<Level> {
    let mut delays: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for (iterations, delay) in answers {
        delays.entry(iterations).or_default().push(delay);
    }
    let level = |(iterations, mut delays): (u32, Vec<f64>)| {
        delays.sort_by(f64::total_cmp);
        Some(Level { iterations, delay_us: percentile(&delays, 50)?, count: delays.len() })
    };
    delays.into_iter().filter_map(level).collect()
}

/// The line through the levels; `None` when all answers took as many iterations.
///
/// Weighted median of the slopes of all pairs of levels (P. K. Sen, JASA 1968), then of the intercepts: a preempted or cold answer moves
/// neither. A pair weighs as many answers and iterations as it spans.
pub fn fit(levels: &[Level]) -> Option<IterationCost> {
    let mut slopes = Vec::new();
    for (i, a) in levels.iter().enumerate() {
        for b in &levels[i + 1..] {
            let run = f64::from(b.iterations) - f64::from(a.iterations);
            slopes.push(((b.delay_us - a.delay_us) / run, (a.count * b.count) as f64 * run));
        }
    }
    let per_iteration_us = weighted_median(slopes)?;
    let intercept = |level: &Level| (level.delay_us - per_iteration_us * f64::from(level.iterations), level.count as f64);
    let setup_us = weighted_median(levels.iter().map(intercept).collect())?;
    Some(IterationCost { setup_us, per_iteration_us })
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
            (iterations, 100.0 + 50.0 * f64::from(iterations) + held_up)
        });
        let cost = fit(&levels(answers)).unwrap();
        assert!((cost.per_iteration_us - 50.0).abs() < 0.5 && (cost.setup_us - 101.0).abs() < 3.0, "{cost:?}");
    }

    #[test]
    fn one_level_makes_no_line() {
        assert_eq!(fit(&levels([(3, 10.0), (3, 11.0)])), None);
        assert_eq!(fit(&[]), None);
    }
}
