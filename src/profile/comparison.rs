//! Compares two methods of keeping a time limit: a fixed iteration count from the look-up table, and a time contract based on
//! learned costs.

use std::sync::Arc;
use std::time::Duration;

use super::ProfileError;
use super::cost::Level;
use super::look_up::{LookUpTable, RaysByIteration, iterations_by_costs};
use super::run::{Run, StudyData, run};
use super::variant::Variant;
use crate::anytime::clock::Clock;
use crate::config::Config;
use crate::quantile;

/// Result of one of the two methods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MethodResult {
    /// Iterations that fit into the time limit according to the method.
    pub iterations: u32,
    /// Fraction of the answers that missed the time limit.
    pub late: f64,
    /// 99th percentile of the delay, us.
    pub p99_us: f64,
    /// Mean position error, m.
    pub position_mean_m: f64,
}

/// Results of both methods for one variant and time limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// The variant.
    pub variant: Variant,
    /// The time limit.
    pub delta: Duration,
    /// With the look-up table; `None` if not even one iteration fits.
    pub table: Option<MethodResult>,
    /// With a time contract.
    pub contract: MethodResult,
}

/// Data and settings of the comparison.
pub struct ComparisonSetup<'a> {
    /// Bag and ground truth.
    pub input: StudyData<'a>,
    /// Configuration shared by both methods.
    pub config: &'a Config,
    /// Number of runs of each method.
    pub rounds: u32,
    /// Creates the clock of a run.
    pub new_clock: &'a dyn Fn() -> Arc<dyn Clock>,
}

impl ComparisonSetup<'_> {
    /// Runs both methods. `beams` is the number of beams of a scan.
    pub fn compare(
        &self,
        variant: Variant,
        delta: Duration,
        (table, levels, beams): (&LookUpTable, &[Level], usize),
        on_message: &mut impl FnMut(),
    ) -> Result<Comparison, ProfileError> {
        let mut config = self.config.clone();
        variant.set(&mut config);
        let rays = RaysByIteration::new(levels, beams as u64);
        let iterations = table.iterations_for(delta, &rays);
        config.contract.time_budget.0 = 0.0;
        let mut limited = config.clone();
        limited.matching.max_iterations = iterations;
        config.contract.time_budget.0 = delta.as_secs_f64();
        let (mut by_table, mut by_contract) = (Vec::new(), Vec::new());
        for _ in 0..self.rounds {
            if iterations > 0 {
                by_table.push(run(self.input, variant, &limited, &(self.new_clock)(), false, &mut *on_message)?);
            }
            by_contract.push(run(self.input, variant, &config, &(self.new_clock)(), false, &mut *on_message)?);
        }
        let costs = by_contract.last().and_then(|run| run.costs.as_ref());
        let learned = costs.map_or(0, |costs| iterations_by_costs(costs, delta, &rays));
        let table = (iterations > 0).then(|| MethodResult::of(&by_table, iterations, delta));
        Ok(Comparison { variant, delta, table, contract: MethodResult::of(&by_contract, learned, delta) })
    }
}

impl MethodResult {
    fn of(runs: &[Run], iterations: u32, delta: Duration) -> Self {
        let scans = || runs.iter().flat_map(|run| &run.scans);
        let mut delays: Vec<f64> = scans().filter_map(|scan| scan.delay_us).collect();
        delays.sort_by(f64::total_cmp);
        let delta_us = delta.as_secs_f64() * 1e6;
        let late = delays.iter().filter(|delay| **delay > delta_us).count();
        let errors: Vec<f64> = scans().filter_map(|scan| scan.error).map(|error| error.distance()).collect();
        Self {
            iterations,
            late: late as f64 / delays.len().max(1) as f64,
            p99_us: quantile::of_sorted(&delays, 0.99).unwrap_or_default(),
            position_mean_m: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
        }
    }
}
