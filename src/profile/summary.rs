//! Summary statistics of runs.

use super::plan::Case;
use super::run::Run;
use crate::evaluation::statistics::Statistics;
use crate::quantile;

/// Delays, us.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Delays {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// Statistics of absolute errors: of positions in m, or of orientations in rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorFigures {
    /// Mean square.
    pub mean_square: f64,
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
}

impl ErrorFigures {
    fn of(mut sizes: Vec<f64>) -> Self {
        sizes.sort_by(f64::total_cmp);
        let count = sizes.len().max(1) as f64;
        Self {
            mean_square: sizes.iter().map(|size| size * size).sum::<f64>() / count,
            mean: sizes.iter().sum::<f64>() / count,
            p95: quantile::of_sorted(&sizes, 0.95).unwrap_or_default(),
        }
    }

    /// Root mean square.
    pub fn rmse(&self) -> f64 {
        self.mean_square.sqrt()
    }
}

/// Statistics of one run, or medians over the runs of a case.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Number of scans with an answer.
    pub scans: usize,
    /// Number of scans without a match, answered with a prediction.
    pub failed: f64,
    /// Delays.
    pub delay: Delays,
    /// Position errors.
    pub position: ErrorFigures,
    /// Orientation errors.
    pub orientation: ErrorFigures,
    /// RMS drift per metre of the path, m and rad; NaN on paths shorter than a metre.
    pub drift: (f64, f64),
    /// Mean number of iterations per scan.
    pub mean_iterations: f64,
}

impl Figures {
    /// Statistics of one run.
    pub fn of(run: &Run) -> Self {
        let scans = run.scans.len();
        let count = scans.max(1) as f64;
        let mut delays: Vec<f64> = run.scans.iter().filter_map(|scan| scan.delay_us).collect();
        delays.sort_by(f64::total_cmp);
        let errors = || run.scans.iter().filter_map(|scan| scan.error);
        Self {
            scans,
            failed: run.scans.iter().filter(|scan| !scan.matched).count() as f64,
            delay: Delays {
                mean: delays.iter().sum::<f64>() / delays.len().max(1) as f64,
                p50: quantile::of_sorted(&delays, 0.5).unwrap_or_default(),
                p99: quantile::of_sorted(&delays, 0.99).unwrap_or_default(),
            },
            position: ErrorFigures::of(errors().map(|error| error.distance()).collect()),
            orientation: ErrorFigures::of(errors().map(|error| error.theta.abs()).collect()),
            drift: run.drift.unwrap_or((f64::NAN, f64::NAN)),
            mean_iterations: run.scans.iter().map(|scan| f64::from(scan.iterations)).sum::<f64>() / count,
        }
    }

    /// Medians over rounds. Without a time budget only the delays differ between rounds.
    pub fn median(rounds: &[Self]) -> Self {
        let of =
            |figure: &dyn Fn(&Self) -> f64| Statistics::of(rounds.iter().map(figure).collect()).map_or(f64::NAN, |s| s.median);
        let errors = |errors: &dyn Fn(&Self) -> ErrorFigures| ErrorFigures {
            mean_square: of(&|f| errors(f).mean_square),
            mean: of(&|f| errors(f).mean),
            p95: of(&|f| errors(f).p95),
        };
        Self {
            scans: rounds.first().map_or(0, |round| round.scans),
            failed: of(&|f| f.failed),
            delay: Delays { mean: of(&|f| f.delay.mean), p50: of(&|f| f.delay.p50), p99: of(&|f| f.delay.p99) },
            position: errors(&|f| f.position),
            orientation: errors(&|f| f.orientation),
            drift: (of(&|f| f.drift.0), of(&|f| f.drift.1)),
            mean_iterations: of(&|f| f.mean_iterations),
        }
    }
}

/// A case and the statistics of its runs.
#[derive(Clone, Debug)]
pub struct CaseSummary {
    /// The case.
    pub case: Case,
    /// Number of rounds.
    pub rounds: u32,
    /// Medians over the rounds.
    pub figures: Figures,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_equal_rounds_is_bitwise_equal_to_each() {
        let round = |mean: f64| Figures {
            delay: Delays { mean, ..Delays::default() },
            position: ErrorFigures::of(vec![0.1, 0.3, 0.2]),
            ..Figures::default()
        };
        for rounds in [vec![round(1.0), round(5.0), round(2.0)], vec![round(1.0), round(3.0)]] {
            let median = Figures::median(&rounds);
            assert_eq!((median.delay.mean, median.position), (2.0, rounds[0].position));
        }
    }
}
