//! Summary of a replay, as text and as JSON.

use std::fmt::Write as _;
use std::time::Duration;

use comfy_table::{Table, presets};
use serde_json::{Value, json};

use super::failures::Failures;
use super::row::MatchRow;
use super::{ReplayLog, microseconds, path_length, time_percentiles};
use crate::app::MountSource;
use crate::evaluation::consistency::{Consistency, UncertainPose};
use crate::evaluation::report::Report;
use crate::evaluation::trajectory::StampedPose;
use crate::odometry::OdometryCounters;

/// Collects the estimates of a replay.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    poses: Vec<StampedPose>,
    uncertain_poses: Vec<UncertainPose>,
    elapsed: Vec<Duration>,
    iterations: u64,
    matched: usize,
    failures: Failures,
    /// Shortest and longest time budget.
    budgets: Option<(Duration, Duration)>,
    /// Number of answers with an error bound, and number of those that kept it.
    bounded: (usize, usize),
    /// Number of answers under conditions outside those of the profile, and how the first differs.
    outside_profile: Option<(usize, String)>,
    /// Number of missed deadlines.
    misses: usize,
    worst_overrun: Duration,
}

/// The parts of a summary that are known only at the end of the replay.
#[derive(Clone, Debug)]
pub struct Ending {
    /// Messages that could not be used.
    pub log: ReplayLog,
    /// Counters of the odometry.
    pub counters: OdometryCounters,
    /// Time by which the scans lag behind the odometry, s.
    pub odometry_lag: f64,
    /// Where the mount of the laser is known from.
    pub mount_source: MountSource,
    /// Comparison with the truth.
    pub report: Option<Report>,
    /// Consistency of the covariances of the poses in the odom frame.
    pub consistency: Option<Consistency>,
    /// Damage of the bag, one text each.
    pub bag_problems: Vec<String>,
}

impl Ending {
    /// Warnings for the user, with remedies where there are any.
    fn problems(&self) -> Vec<String> {
        let mut problems = self.bag_problems.clone();
        problems.extend(self.log.problems());
        problems.extend(self.mount_source.warning().map(Into::into));
        problems.extend(self.counters.in_words());
        problems
    }
}

impl Summary {
    /// Adds an answer. Returns its pose.
    pub fn add(&mut self, MatchRow { pose, report, uncertain_pose }: &MatchRow) -> StampedPose {
        let pose = StampedPose { stamp: report.header.stamp.into(), pose: *pose };
        self.poses.push(pose);
        self.uncertain_poses.push(*uncertain_pose);
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

    /// The trajectory of the base in the map frame.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The poses of the base in the odom frame, with their covariances.
    pub fn uncertain_poses(&self) -> &[UncertainPose] {
        &self.uncertain_poses
    }

    /// Explains why the replay failed, if it did: every scan was malformed, or the laser is not mounted level.
    pub fn failure(&self) -> Option<String> {
        let (unusable, scans) = (self.failures.unusable(), self.poses.len());
        (scans > 0 && unusable.count() == scans).then(|| unusable.descriptions(scans).join("; "))
    }

    /// All warnings for the user, with remedies where there are any.
    fn problems(&self, ending: &Ending) -> Vec<String> {
        let failures = self.failures.descriptions(self.poses.len());
        let outside_profile = self.outside_profile.as_ref().map(|(count, first)| {
            format!(
                "{count} scans differ from those of contract.profile, so its expected errors do not apply; the first: {first}"
            )
        });
        failures.into_iter().chain(outside_profile).chain(ending.problems()).collect()
    }

    fn mean_iterations(&self) -> f64 {
        self.iterations as f64 / self.poses.len().max(1) as f64
    }

    /// Formats the summary as a JSON object.
    pub fn to_json(&self, ending: &Ending) -> Value {
        let [p50, p99, max] = time_percentiles(&self.elapsed);
        let truth = ending.report.as_ref().map_or_else(|| json!({}), Report::to_json);
        json!({
            "scans": self.poses.len(),
            "matched": self.matched,
            "failed": self.poses.len() - self.matched,
            "failures": self.failures.counts(),
            "path_length_m": path_length(&self.poses),
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

    /// Formats the summary as text for a terminal of `width` columns; `None` for unlimited width.
    pub fn to_text(&self, ending: &Ending, width: Option<usize>) -> String {
        let [p50, p99, max] = time_percentiles(&self.elapsed);
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.add_row(["scans", &self.poses.len().to_string()]);
        table.add_row(["matched", &self.matched.to_string()]);
        table.add_row(["failed", &(self.poses.len() - self.matched).to_string()]);
        for (reason, count) in self.failures.counts() {
            table.add_row(["", &format!("{count}: {reason}")]);
        }
        table.add_row(["path length", &format!("{:.2} m", path_length(&self.poses))]);
        table.add_row(["keyframes", &ending.counters.keyframes.to_string()]);
        table.add_row(["closed loops", &ending.counters.closed_loops.to_string()]);
        if ending.odometry_lag != 0.0 {
            table.add_row([
                "odometry lag",
                &format!("the scans match the poses that odometry reports {:.2} s earlier", ending.odometry_lag),
            ]);
        }
        table.add_row(["mean iterations", &format!("{:.1}", self.mean_iterations())]);
        table.add_row(["time", &format!("p50 {p50:.0} us, p99 {p99:.0} us, max {max:.0} us")]);
        if let Some((shortest, longest)) = self.budgets {
            let overrun = microseconds(self.worst_overrun);
            let percent = 100.0 * self.misses as f64 / self.poses.len().max(1) as f64;
            let (misses, longest) = (self.misses, microseconds(longest));
            let from =
                if microseconds(shortest) < longest { format!("{:.0} to ", microseconds(shortest)) } else { String::new() };
            let text = format!("{misses} ({percent:.2} %) with time budget {from}{longest:.0} us, worst overrun {overrun:.0} us");
            table.add_row(["deadline misses", &text]);
        }
        if self.bounded.0 > 0 {
            table.add_row(["error bound kept", &format!("{} of {} scans", self.bounded.1, self.bounded.0)]);
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
