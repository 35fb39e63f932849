//! Summary of a replay, as text and as JSON.

use std::fmt::Write as _;
use std::time::Duration;

use comfy_table::{Table, presets};
use serde_json::{Value, json};

use super::failures::Failures;
use super::row::MatchRow;
use super::{ReplayLog, microseconds};
use crate::app::MountSource;
use crate::evaluation::consistency::{Claim, Consistency};
use crate::evaluation::report::Report;
use crate::evaluation::trajectory::StampedPose;
use crate::odometry::OdometryCounters;
use crate::quantile;

/// Collects the estimates of a replay.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    poses: Vec<StampedPose>,
    claims: Vec<Claim>,
    elapsed: Vec<Duration>,
    iterations: u64,
    matched: usize,
    failures: Failures,
    /// Shortest and longest time budget.
    budgets: Option<(Duration, Duration)>,
    /// Answers that had a bound on their error, and those that kept it.
    bounded: (usize, usize),
    /// Answers to scans of another kind than the profile's, and what was first.
    outside_profile: Option<(usize, String)>,
    misses: usize,
    worst_overrun: Duration,
}

/// The parts of a summary that are known only at the end.
#[derive(Clone, Debug)]
pub struct Ending {
    /// Messages that could not be used.
    pub log: ReplayLog,
    /// What the odometry counted.
    pub counters: OdometryCounters,
    /// Scans lag so far behind the odometry, s.
    pub odometry_lag: f64,
    /// Where the laser's place is known from.
    pub mount_source: MountSource,
    /// Comparison with the truth.
    pub report: Option<Report>,
    /// Whether the covariances of the poses in the odom frame hold.
    pub consistency: Option<Consistency>,
    /// Damage of the bag, in words.
    pub bag_problems: Vec<String>,
}

impl Ending {
    /// Problems worth knowing, each with its remedy where there is one.
    fn problems(&self) -> Vec<String> {
        let mut problems = self.bag_problems.clone();
        problems.extend(self.log.problems());
        problems.extend(self.mount_source.reservation().map(Into::into));
        problems.extend(self.counters.in_words());
        problems
    }
}

impl Summary {
    /// Adds an answer; returns its pose.
    pub fn add(&mut self, MatchRow { pose, report, claim }: &MatchRow) -> StampedPose {
        let pose = StampedPose { stamp: report.header.stamp.into(), pose: *pose };
        self.poses.push(pose);
        self.claims.push(*claim);
        self.elapsed.push(report.elapsed.span());
        self.iterations += u64::from(report.iterations);
        self.matched += usize::from(report.ok);
        if !report.ok {
            self.failures.add(&report.failure, &report.reason);
        }
        let budget = report.time_budget.span();
        if !budget.is_zero() {
            let (shortest, longest) = self.budgets.unwrap_or((budget, budget));
            self.budgets = Some((shortest.min(budget), longest.max(budget)));
        }
        if report.translation_error_bound > 0.0 || report.rotation_error_bound > 0.0 {
            let kept = report.translation_error_excess <= 0.0 && report.rotation_error_excess <= 0.0;
            self.bounded = (self.bounded.0 + 1, self.bounded.1 + usize::from(kept));
        }
        if !report.outside_profile.is_empty() {
            self.outside_profile.get_or_insert_with(|| (0, report.outside_profile.clone())).0 += 1;
        }
        self.misses += usize::from(!report.deadline_met);
        self.worst_overrun = self.worst_overrun.max(report.overrun.span());
        pose
    }

    /// The trajectory of the base.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The poses of the base in the odom frame, and what is said of their errors.
    pub fn claims(&self) -> &[Claim] {
        &self.claims
    }

    /// Why the answers are worth nothing, if they are: every scan was malformed, or of a laser on edge.
    pub fn hollow(&self) -> Option<String> {
        let (unusable, scans) = (self.failures.unusable(), self.poses.len());
        (scans > 0 && unusable.count() == scans).then(|| unusable.in_words(scans).join("; "))
    }

    /// Problems worth knowing, each with its remedy where there is one.
    fn problems(&self, ending: &Ending) -> Vec<String> {
        let failures = self.failures.in_words(self.poses.len());
        let elsewhere = self.outside_profile.as_ref().map(|(count, first)| {
            format!(
                "{count} scans are of another kind than those of contract.profile, whose errors are not to be relied on: {first}"
            )
        });
        failures.into_iter().chain(elsewhere).chain(ending.problems()).collect()
    }

    fn path_length(&self) -> f64 {
        self.poses.windows(2).map(|pair| pair[0].pose.between(&pair[1].pose).distance()).sum()
    }

    /// Elapsed time at percentiles 50, 99 and 100, microseconds.
    fn times(&self) -> [f64; 3] {
        let mut sorted = self.elapsed.clone();
        sorted.sort_unstable();
        [0.5, 0.99, 1.0].map(|share| quantile::of_sorted(&sorted, share).map_or(0.0, microseconds))
    }

    fn mean_iterations(&self) -> f64 {
        self.iterations as f64 / self.poses.len().max(1) as f64
    }

    /// One JSON object.
    pub fn to_json(&self, ending: &Ending) -> Value {
        let [p50, p99, max] = self.times();
        let truth = ending.report.as_ref().map_or_else(|| json!({}), Report::to_json);
        json!({
            "scans": self.poses.len(),
            "matched": self.matched,
            "failed": self.poses.len() - self.matched,
            "failures": self.failures.counts(),
            "path_length_m": self.path_length(),
            "mean_iterations": self.mean_iterations(),
            "keyframes": ending.counters.keyframes,
            "closed_loops": ending.counters.closed_loops,
            "odometry_lag_s": ending.odometry_lag,
            "time_us": {"p50": p50, "p99": p99, "max": max},
            "deadline": {
                "budget_us": self.budgets.filter(|(shortest, longest)| shortest == longest).map(|(budget, _)| microseconds(budget)),
                "budget_range_us": self.budgets.map(|(shortest, longest)| [microseconds(shortest), microseconds(longest)]),
                "misses": self.misses,
                "miss_ratio": self.misses as f64 / self.poses.len().max(1) as f64,
                "worst_overrun_us": microseconds(self.worst_overrun),
            },
            "error_bound": {"scans": self.bounded.0, "kept": self.bounded.1},
            "ate_rmse_m": truth["ate_rmse_m"],
            "rpe_1m_rmse_m": truth["rpe_1m_rmse_m"],
            "rpe_1m_rmse_deg": truth["rpe_1m_rmse_deg"],
            "consistency": ending.consistency,
            "unusable_messages": ending.log.unusable_messages,
            "bag_problems": ending.bag_problems,
            "problems": self.problems(ending),
        })
    }

    /// A table for people, on a terminal of so many columns; `None`: as wide as it gets.
    pub fn to_text(&self, ending: &Ending, width: Option<usize>) -> String {
        let [p50, p99, max] = self.times();
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.add_row(["scans", &self.poses.len().to_string()]);
        table.add_row(["matched", &self.matched.to_string()]);
        table.add_row(["failed", &(self.poses.len() - self.matched).to_string()]);
        for (reason, count) in self.failures.counts() {
            table.add_row(["", &format!("{count}: {reason}")]);
        }
        table.add_row(["path length", &format!("{:.2} m", self.path_length())]);
        table.add_row(["keyframes", &ending.counters.keyframes.to_string()]);
        table.add_row(["closed loops", &ending.counters.closed_loops.to_string()]);
        if ending.odometry_lag != 0.0 {
            table.add_row([
                "odometry lag",
                &format!("scans show the robot where odometry had it {:.2} s before", ending.odometry_lag),
            ]);
        }
        table.add_row(["mean iterations", &format!("{:.1}", self.mean_iterations())]);
        table.add_row(["time", &format!("p50 {p50:.0} us, p99 {p99:.0} us, max {max:.0} us")]);
        if let Some((shortest, longest)) = self.budgets {
            let overrun = microseconds(self.worst_overrun);
            let share = 100.0 * self.misses as f64 / self.poses.len().max(1) as f64;
            let (misses, longest) = (self.misses, microseconds(longest));
            let from =
                if microseconds(shortest) < longest { format!("{:.0} to ", microseconds(shortest)) } else { String::new() };
            let text = format!("{misses} ({share:.2} %) of budget {from}{longest:.0} us, worst overrun {overrun:.0} us");
            table.add_row(["deadline misses", &text]);
        }
        if self.bounded.0 > 0 {
            table.add_row(["error bound kept", &format!("{} of {}", self.bounded.1, self.bounded.0)]);
        }
        let mut text = format!("{table}\n");
        if let Some(report) = &ending.report {
            let _ = writeln!(text, "\n{}", report.to_text(width));
        }
        if let Some(consistency) = &ending.consistency {
            let _ = writeln!(text, "{consistency}\n");
        }
        for problem in self.problems(ending) {
            let kind = if ending.bag_problems.contains(&problem) { "warning: the bag is damaged" } else { "note" };
            let _ = writeln!(text, "{kind}: {problem}");
        }
        text
    }
}
