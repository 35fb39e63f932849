//! Statistics of how the contract was kept.

use std::fmt::{self, Write as _};
use std::time::Duration;

use crate::messages::own::MatchReport;
use crate::quantile;

/// Answers whose edge has come and whose report has not, or the other way round: more than these are not on their way any more.
const IN_FLIGHT: i64 = 2;

/// What has been counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    edges: u64,
    reports: u64,
    /// Reports with a time budget in force ...
    budgeted: u64,
    /// ... and of these, the ones that missed it.
    late: u64,
    worst_overrun: Duration,
    /// Reports with an error bound in force ...
    bounded: u64,
    /// ... and of these, the ones that kept it.
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
        let share = 100.0 * self.late as f64 / self.budgeted.max(1) as f64;
        let overrun = milliseconds(self.worst_overrun);
        write!(f, "{} scans, {} reports, {} late ({share:.2} %)", self.edges, self.reports, self.late)?;
        write!(f, ", worst overrun {overrun:.2} ms")?;
        if self.bounded > 0 {
            write!(f, ", error bounds kept by {} of {}", self.bounds_kept, self.bounded)?;
        }
        Ok(())
    }
}

/// Takes edges and reports, and sums up.
#[derive(Default)]
pub(super) struct Adherence {
    total: Tally,
    period: Tally,
    elapsed: Vec<Duration>,
    budgets: Duration,
    state: Option<i32>,
    /// Edges ahead of reports at the beginning: the two topics are not connected at the same moment.
    ahead: Option<i64>,
}

impl Adherence {
    /// A message of `icp_state`: an edge when it is not the value of the one before.
    pub(super) fn on_state(&mut self, value: i32) {
        if self.state.replace(value) != Some(value) {
            self.each(|tally| tally.edges += 1);
        }
        self.note_beginning();
    }

    /// A message of `icp_report`.
    pub(super) fn on_report(&mut self, report: &MatchReport) {
        self.each(|tally| tally.add(report));
        self.elapsed.push(report.elapsed.span());
        self.budgets += report.time_budget.span();
        self.note_beginning();
    }

    /// Everything so far.
    pub(super) fn total(&self) -> Tally {
        self.total
    }

    /// The line about the time since the last one, and a new beginning.
    pub(super) fn sum_up(&mut self) -> String {
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
            let _ = write!(line, ", of {:.2} ms allowed on average", mean(budgets, period.budgeted));
        }
        line
    }

    /// What is wrong if edges and reports have drawn apart since the last look by more than is on its way.
    pub(super) fn disagreement(&mut self) -> Option<String> {
        let (before, now) = (self.ahead?, self.edges_ahead());
        let apart = now - before;
        (apart.abs() > IN_FLIGHT).then(|| {
            self.ahead = Some(now);
            let more = if apart > 0 { "edges of icp_state than reports" } else { "reports than edges of icp_state" };
            format!("{} more {more}: messages were lost", apart.abs())
        })
    }

    fn each(&mut self, change: impl Fn(&mut Tally)) {
        change(&mut self.total);
        change(&mut self.period);
    }

    fn note_beginning(&mut self) {
        if self.ahead.is_none() && self.total.edges > 0 && self.total.reports > 0 {
            self.ahead = Some(self.edges_ahead());
        }
    }

    fn edges_ahead(&self) -> i64 {
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
    fn a_period_is_summed_up_and_the_next_one_begins_empty() {
        let mut adherence = Adherence::default();
        for (elapsed, budget) in [(2, 4), (6, 4), (3, 4), (9, 0)] {
            adherence.on_report(&report(elapsed, budget));
        }
        for value in [1, 0, 1, 1, 0] {
            adherence.on_state(value);
        }
        let line = adherence.sum_up();
        assert_eq!(
            line,
            "4 scans, 4 reports, 1 late (33.33 %), worst overrun 2.00 ms; elapsed mean 5.00 ms, p99 9.00 ms, of 4.00 ms allowed on \
             average"
        );
        assert_eq!(adherence.sum_up(), "0 scans, 0 reports, 0 late (0.00 %), worst overrun 0.00 ms");
        assert_eq!((adherence.total().edges, adherence.total().late), (4, 1));
    }

    #[test]
    fn error_bounds_count_only_where_there_are_some() {
        let mut adherence = Adherence::default();
        let bounded = |excess| MatchReport { translation_error_bound: 0.01, translation_error_excess: excess, ..report(1, 2) };
        for report in [report(1, 2), bounded(0.0), bounded(0.002), bounded(f64::INFINITY)] {
            adherence.on_report(&report);
        }
        assert!(adherence.total().to_string().ends_with("error bounds kept by 1 of 3"), "{}", adherence.total());
    }

    #[test]
    fn edges_and_reports_that_draw_apart_are_told_once() {
        let mut adherence = Adherence::default();
        let edges = |adherence: &mut Adherence, from: i32, count: i32| {
            (from..from + count).for_each(|number| adherence.on_state(number % 2));
        };
        edges(&mut adherence, 1, 5); // before reports are connected
        adherence.on_report(&report(1, 2));
        edges(&mut adherence, 6, 2);
        assert_eq!(adherence.disagreement(), None, "in flight");
        edges(&mut adherence, 8, 1);
        assert!(adherence.disagreement().unwrap().starts_with("3 more edges"));
        assert_eq!(adherence.disagreement(), None);
        (0..4).for_each(|_| adherence.on_report(&report(1, 2)));
        assert!(adherence.disagreement().unwrap().starts_with("4 more reports"));
    }
}
