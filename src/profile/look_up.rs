//! The look-up table approach of the study that introduced contracts: a fitted delay = a + b * iterations + c * rays determines
//! how many iterations fit into a time limit.
//!
//! For comparison, the same number is computed from the learned costs that the scan matcher uses to keep its contracts.

use std::time::Duration;

use nalgebra::{Matrix2, Vector2};

use super::cost::Level;
use crate::anytime::RemainingBudget;
use crate::anytime::cost_model::{CostModel, Phase};

/// Largest `matching.max_iterations` that the configuration accepts.
const MAX_ITERATIONS: u32 = 1000;
/// Singular values of the correlation matrix of iterations and rays below this count as zero: the two are then collinear and
/// their effects on the delay cannot be separated.
const MIN_SINGULAR_VALUE: f64 = 1e-9;

/// A least-squares plane through the delays of all answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookUpTable {
    /// a: delay without any iteration, us.
    pub setup_us: f64,
    /// b: delay per iteration, us.
    pub per_iteration_us: f64,
    /// c: delay per ray of an iteration, us.
    pub per_ray_us: f64,
    /// Fraction of the delays' variance that the plane explains (R^2).
    pub r_squared: f64,
}

impl LookUpTable {
    /// Fits the plane to answers given as (iterations, rays summed over the iterations, delay in us); `None` if all have the same
    /// iterations and rays.
    pub fn fit(answers: &[(u32, u64, f64)]) -> Option<Self> {
        let count = answers.len() as f64;
        let rows = || answers.iter().map(|&(iterations, rays, delay)| (Vector2::new(f64::from(iterations), rays as f64), delay));
        let mean = rows().map(|(row, _)| row).sum::<Vector2<f64>>() / count;
        let mean_delay = rows().map(|(_, delay)| delay).sum::<f64>() / count;
        let variances = rows().map(|(row, _)| (row - mean).map(|x| x * x)).sum::<Vector2<f64>>() / count;
        let scale = variances.map(|variance| if variance > 0.0 { variance.sqrt() } else { f64::INFINITY });
        let (mut correlation, mut with_delay) = (Matrix2::zeros(), Vector2::zeros());
        for (row, delay) in rows() {
            let scaled = (row - mean).component_div(&scale);
            correlation += scaled * scaled.transpose() / count;
            with_delay += scaled * (delay - mean_delay) / count;
        }
        let slopes = correlation.pseudo_inverse(MIN_SINGULAR_VALUE).ok()? * with_delay;
        let slopes = slopes.component_div(&scale);
        let fitted = |row: Vector2<f64>| mean_delay + slopes.dot(&(row - mean));
        let residual: f64 = rows().map(|(row, delay)| (delay - fitted(row)).powi(2)).sum();
        let total: f64 = rows().map(|(_, delay)| (delay - mean_delay).powi(2)).sum();
        variances.iter().any(|variance| *variance > 0.0).then(|| Self {
            setup_us: fitted(Vector2::zeros()),
            per_iteration_us: slopes.x,
            per_ray_us: slopes.y,
            r_squared: if total > 0.0 { 1.0 - residual / total } else { 1.0 },
        })
    }

    /// Expected delay, us. `rays` is summed over the iterations.
    pub fn delay_us(&self, iterations: u32, rays: u64) -> f64 {
        self.setup_us + self.per_iteration_us * f64::from(iterations) + self.per_ray_us * rays as f64
    }

    /// Number of iterations that fit into `delta`.
    pub fn iterations_for(&self, delta: Duration, rays: &RaysByIteration) -> u32 {
        let delta_us = delta.as_secs_f64() * 1e6;
        (1..=MAX_ITERATIONS).take_while(|&n| self.delay_us(n, rays.after(n)) <= delta_us).last().unwrap_or(0)
    }
}

/// Number of iterations that fit into `delta` according to learned costs, with the confidence that the costs were learned for.
pub fn iterations_by_costs(costs: &CostModel, delta: Duration, rays: &RaysByIteration) -> u32 {
    let remaining = RemainingBudget::new(costs, delta, delta);
    let size = |rays: u64| usize::try_from(rays).unwrap_or(usize::MAX);
    let mut pieces = vec![(Phase::Setup, size(rays.all))];
    let fits = |n: &u32| {
        let last = size(rays.after(*n) - rays.after(n - 1));
        pieces.push((Phase::Iteration, last));
        pieces.push((Phase::Closing, last));
        let fits = remaining.fits(&pieces);
        pieces.pop();
        fits
    };
    (1..=MAX_ITERATIONS).take_while(fits).last().unwrap_or(0)
}

/// Cumulative number of rays by iteration: the first iterations of a match use few rays.
#[derive(Clone, Debug, PartialEq)]
pub struct RaysByIteration {
    /// Rays used after 0, 1, 2, ... iterations.
    rays: Vec<u64>,
    /// Rays of a scan.
    all: u64,
}

impl RaysByIteration {
    /// From measured levels, and the number of rays of a scan.
    pub fn new(levels: &[Level], all: u64) -> Self {
        let mut rays = vec![0];
        for level in levels {
            let before = rays[rays.len() - 1];
            let missing = u64::from(level.iterations).saturating_sub(rays.len() as u64 - 1);
            // Interpolate linearly over iteration counts without an answer.
            let step = level.rays.saturating_sub(before) / missing.max(1);
            rays.extend((1..=missing).map(|k| before + k * step));
        }
        Self { rays, all }
    }

    /// Rays used after `iterations` iterations; iterations beyond the measured ones count with all rays.
    pub fn after(&self, iterations: u32) -> u64 {
        let known = self.rays.len() - 1;
        let iterations = iterations as usize;
        self.rays[iterations.min(known)] + iterations.saturating_sub(known) as u64 * self.all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::cost::levels;

    fn us(time: u64) -> Duration {
        Duration::from_micros(time)
    }

    #[test]
    fn the_plane_and_its_r_squared_are_found() {
        let answers: Vec<_> = (0..300_u32)
            .map(|i| (1 + i % 7, u64::from(100 + 37 * (i % 11)), f64::from(i % 3) - 1.0))
            .map(|(n, rays, noise)| (n, rays, 20.0 + 4.0 * f64::from(n) + 0.05 * rays as f64 + noise))
            .collect();
        let table = LookUpTable::fit(&answers).unwrap();
        assert!((table.setup_us - 20.0).abs() < 0.3 && (table.per_iteration_us - 4.0).abs() < 0.05, "{table:?}");
        assert!((table.per_ray_us - 0.05).abs() < 0.001 && (0.97..0.9999).contains(&table.r_squared), "{table:?}");
    }

    #[test]
    fn collinear_iterations_and_rays_still_predict_delays() {
        let answers: Vec<_> = (1..6_u32).map(|n| (n, u64::from(100 * n), 10.0 + 5.0 * f64::from(n))).collect();
        let table = LookUpTable::fit(&answers).unwrap();
        assert!((table.delay_us(3, 300) - 25.0).abs() < 1e-6 && table.r_squared > 0.999_999, "{table:?}");
        assert_eq!(LookUpTable::fit(&[(3, 300, 10.0), (3, 300, 12.0)]), None);
        assert_eq!(LookUpTable::fit(&[]), None);
    }

    #[test]
    fn the_rays_limit_how_many_iterations_fit() {
        let table = LookUpTable { setup_us: 10.0, per_iteration_us: 2.0, per_ray_us: 0.1, r_squared: 1.0 };
        // Iterations with 100, 100, then 400 rays each.
        let rays = RaysByIteration::new(&levels([(1, 100, 0.0), (2, 200, 0.0), (4, 1000, 0.0)]), 400);
        assert_eq!([0, 1, 2, 3, 4, 6].map(|n| rays.after(n)), [0, 100, 200, 600, 1000, 1800]);
        let fitting = [5, 22, 23, 34, 76, 118, 160].map(|delta| table.iterations_for(us(delta), &rays));
        assert_eq!(fitting, [0, 1, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn learned_costs_leave_room_for_slow_iterations() {
        let mut costs = CostModel::new(0.99);
        for i in 0..200 {
            costs.observe(Phase::Setup, 400, us(20));
            costs.observe(Phase::Iteration, 400, us(if i % 10 == 0 { 20 } else { 10 }));
            costs.observe(Phase::Closing, 400, us(5));
        }
        costs.learn();
        let rays = RaysByIteration::new(&[], 400);
        let fitting = [20, 44, 57, 67].map(|delta| iterations_by_costs(&costs, us(delta), &rays));
        assert_eq!(fitting, [0, 0, 2, 3], "20 + 10 n + 5, with one slow iteration that takes 10 longer");
    }
}
