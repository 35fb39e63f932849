//! Statistics of how well the contract was kept.

use std::fmt::{self, Write as _};
use std::time::Duration;

use crate::messages::own::MatchReport;
use crate::quantile;

/// Maximum number of answers of which only the edge or only the report has arrived so far. A larger difference means lost
/// messages.
const IN_FLIGHT: i64 = 2;

/// Counts of edges and reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    edges: u64,
    reports: u64,
    /// Reports with a time budget.
    budgeted: u64,
    /// Reports that missed their time budget.
    late: u64,
    worst_overrun: Duration,
    /// Reports with an error bound.
    bounded: u64,
    /// Reports that kept their error bounds.
    bounds_kept: u64,
}

impl Tally {
    fn add(&mut self, report: &MatchReport) {
        let budgeted = report.time_budget.seconds() > 0.0;
        let bounded = report.translation_error_bound > 0.0 || report.rotation_error_bound > 0.0;
        let kept = report.translation_error_excess <= 0.0 && report.rotation_error_excess <= 0.0;
        self.reports += 1;
        self.budgeted += u64::from(budgeted);
        self.late += u64::from(budgeted && !report.deadline_met);
        self.worst_overrun = self.worst_overrun.max(report.overrun.span());
        self.bounded += u64::from(bounded);
        self.bounds_kept += u64::from(bounded && kept);
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percentage = 100.0 * self.late as f64 / self.budgeted.max(1) as f64;
        let overrun = milliseconds(self.worst_overrun);
        write!(f, "{} scans, {} reports, {} late ({percentage:.2} %)", self.edges, self.reports, self.late)?;
        write!(f, ", worst overrun {overrun:.2} ms")?;
        if self.bounded > 0 {
            write!(f, ", error bounds kept by {} of {}", self.bounds_kept, self.bounded)?;
        }
        Ok(())
    }
}

/// Collects edges and reports, and summarizes them.
#[derive(Default)]
pub(super) struct Adherence {
    total: Tally,
    period: Tally,
    elapsed: Vec<Duration>,
    budgets: Duration,
    state: Option<i32>,
    /// Surplus of edges over reports at the last check. It is not zero at first, since the two topics connect at different times.
    surplus: Option<i64>,
}

impl Adherence {
    /// Handles a message of `icp_state`. A change of the value is an edge.
    pub(super) fn on_state(&mut self, value: i32) {
        if self.state.replace(value) != Some(value) {
            self.each(|tally| tally.edges += 1);
        }
        self.set_initial_surplus();
    }

    /// Handles a message of `icp_report`.
    pub(super) fn on_report(&mut self, report: &MatchReport) {
        self.each(|tally| tally.add(report));
        self.elapsed.push(report.elapsed.span());
        self.budgets += report.time_budget.span();
        self.set_initial_surplus();
    }

    /// The counts since the start.
    pub(super) fn total(&self) -> Tally {
        self.total
    }

    /// Returns a summary of the current period, and starts a new one.
    pub(super) fn summarize(&mut self) -> String {
        let period = std::mem::take(&mut self.period);
        let (mut elapsed, budgets) = (std::mem::take(&mut self.elapsed), std::mem::take(&mut self.budgets));
        elapsed.sort_unstable();
        let mean = |sum: Duration, count: u64| milliseconds(sum) / count as f64;
        let mut line = period.to_string();
        if period.reports > 0 {
            let p99 = milliseconds(quantile::of_sorted(&elapsed, 0.99).unwrap_or_default());
            let _ = write!(line, "; elapsed mean {:.2} ms, p99 {p99:.2} ms", mean(elapsed.iter().sum(), period.reports));
        }
        if period.budgeted > 0 {
            let _ = write!(line, ", mean budget {:.2} ms", mean(budgets, period.budgeted));
        }
        line
    }

    /// Returns a warning if the numbers of edges and reports have diverged since the last check, that is, if messages were lost.
    pub(super) fn lost_messages(&mut self) -> Option<String> {
        let (before, now) = (self.surplus?, self.edge_surplus());
        let difference = now - before;
        (difference.abs() > IN_FLIGHT).then(|| {
            self.surplus = Some(now);
            let more = if difference > 0 { "edges of icp_state than reports" } else { "reports than edges of icp_state" };
            format!("{} more {more}: messages were lost", difference.abs())
        })
    }

    fn each(&mut self, change: impl Fn(&mut Tally)) {
        change(&mut self.total);
        change(&mut self.period);
    }

    fn set_initial_surplus(&mut self) {
        if self.surplus.is_none() && self.total.edges > 0 && self.total.reports > 0 {
            self.surplus = Some(self.edge_surplus());
        }
    }

    fn edge_surplus(&self) -> i64 {
        self.total.edges.cast_signed() - self.total.reports.cast_signed()
    }
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages;

    fn report(elapsed_ms: u32, budget_ms: u32) -> MatchReport {
        let span = |milliseconds: u32| messages::Duration { sec: 0, nsec: (milliseconds * 1_000_000).cast_signed() };
        MatchReport {
            time_budget: span(budget_ms),
            elapsed: span(elapsed_ms),
            deadline_met: budget_ms == 0 || elapsed_ms <= budget_ms,
            overrun: span(if budget_ms == 0 { 0 } else { elapsed_ms.saturating_sub(budget_ms) }),
            ..MatchReport::default()
        }
    }

    #[test]
    fn a_period_is_summarized_and_the_next_one_starts_empty() {
        let mut adherence = Adherence::default();
        for (elapsed, budget) in [(2, 4), (6, 4), (3, 4), (9, 0)] {
            adherence.on_report(&report(elapsed, budget));
        }
        for value in [1, 0, 1, 1, 0] {
            adherence.on_state(value);
        }
        let line = adherence.summarize();
        assert_eq!(
            line,
            "4 scans, 4 reports, 1 late (33.33 %), worst overrun 2.00 ms; elapsed mean 5.00 ms, p99 9.00 ms, mean budget 4.00 ms"
        );
        assert_eq!(adherence.summarize(), "0 scans, 0 reports, 0 late (0.00 %), worst overrun 0.00 ms");
        assert_eq!((adherence.total().edges, adherence.total().late), (4, 1));
    }

    #[test]
    fn only_reports_with_error_bounds_are_counted_for_them() {
        let mut adherence = Adherence::default();
        let bounded = |excess| MatchReport { translation_error_bound: 0.01, translation_error_excess: excess, ..report(1, 2) };
        for report in [report(1, 2), bounded(0.0), bounded(0.002), bounded(f64::INFINITY)] {
            adherence.on_report(&report);
        }
        assert!(adherence.total().to_string().ends_with("error bounds kept by 1 of 3"), "{}", adherence.total());
    }

    #[test]
    fn diverging_edges_and_reports_are_reported_once() {
        let mut adherence = Adherence::default();
        let edges = |adherence: &mut Adherence, from: i32, count: i32| {
            (from..from + count).for_each(|number| adherence.on_state(number % 2));
        };
        edges(&mut adherence, 1, 5); // before reports are connected
        adherence.on_report(&report(1, 2));
        edges(&mut adherence, 6, 2);
        assert_eq!(adherence.lost_messages(), None, "in flight");
        edges(&mut adherence, 8, 1);
        assert!(adherence.lost_messages().unwrap().starts_with("3 more edges"));
        assert_eq!(adherence.lost_messages(), None);
        (0..4).for_each(|_| adherence.on_report(&report(1, 2)));
        assert!(adherence.lost_messages().unwrap().starts_with("4 more reports"));
    }
}
