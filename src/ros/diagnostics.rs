//! The state of the node on `/diagnostics`, once a second of wall time.

use std::collections::BTreeSet;
use std::mem;
use std::sync::Mutex;
use std::time::Duration;

use rosrust::api::Ros;

use super::NodeError;
use super::mailbox::Dropped;
use super::output::Output;
use crate::app::Estimate;
use crate::messages::Time;
use crate::messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use crate::messages::std_msgs::Header;
use crate::odometry::Outcome;
use crate::parallel::lock;
use crate::quantile;

/// Time between two messages.
pub(super) const PERIOD: Duration = Duration::from_secs(1);

/// The laser mount is unknown.
pub(super) const MOUNT_ASSUMED: &str = "the laser mount is unknown, assuming the base origin: set odometry.laser_in_base";
/// The odometry is rejected as a source of prediction.
pub(super) const ODOMETRY_REJECTED: &str = "odometry is not used for prediction: it contradicts the scan matches";
/// A single match contradicts the odometry.
pub(super) const ODOMETRY_CONTRADICTED: &str =
    "the last match contradicts the odometry: the wheels may slip, or the laser sees something that moves with the robot";
/// The IMU is rejected as a source of prediction.
pub(super) const IMU_REJECTED: &str = "the IMU is not used for prediction: it contradicts the scan matches";
/// The scans differ from those that the profile was made from.
pub(super) const OUTSIDE_PROFILE: &str = "the scans differ from those of the profile: its predicted errors are unreliable";
/// A transform is switched off because another node publishes it.
pub(super) const TRANSFORM_WITHHELD: &str = "a transform is not published, since another node publishes it";

/// How the messages describe what a node does with scans.
#[derive(Clone, Copy)]
pub(super) struct TaskWording {
    /// The noun, such as `scan matching`.
    pub(super) title: &'static str,
    /// The present participle, such as `matching`.
    pub(super) doing: &'static str,
    /// The past participle, such as `matched`.
    pub(super) done: &'static str,
}

/// Statistics of one answer.
pub(super) struct Sample {
    /// Time from the scan's arrival to the answer.
    pub(super) elapsed: Duration,
    /// Time by which the answer exceeded the time budget.
    pub(super) overrun: Duration,
    /// Why the scan could not be used; `None` if it was used.
    pub(super) problem: Option<String>,
}

impl From<&Estimate> for Sample {
    fn from(estimate: &Estimate) -> Self {
        let problem = match &estimate.registration.outcome {
            Outcome::Predicted(problem) => Some(problem.text.clone()),
            Outcome::Matched | Outcome::First => None,
        };
        Self { elapsed: estimate.elapsed, overrun: estimate.overrun(), problem }
    }
}

/// Statistics that the worker thread collects for the diagnostics.
#[derive(Default)]
pub(super) struct Monitor {
    state: Mutex<State>,
}

#[derive(Clone, Default)]
struct State {
    counts: Counts,
    latencies: Vec<Duration>,
    problem: Option<String>,
    /// Abnormal conditions that hold now.
    conditions: BTreeSet<&'static str>,
    /// Lag of the wheel odometry behind the scans, s; `None` if unknown. Scans show the robot where the odometry had it this much
    /// earlier.
    odometry_lag: Option<f64>,
}

#[derive(Clone, Copy, Default)]
struct Counts {
    answered: u64,
    failed: u64,
    late: u64,
    worst_overrun: Duration,
    rejected: u64,
    oversized: u64,
}

impl Monitor {
    pub(super) fn record(&self, sample: Sample) {
        let mut state = lock(&self.state);
        state.counts.answered += 1;
        state.counts.late += u64::from(!sample.overrun.is_zero());
        state.counts.worst_overrun = state.counts.worst_overrun.max(sample.overrun);
        state.latencies.push(sample.elapsed);
        if let Some(problem) = sample.problem {
            state.counts.failed += 1;
            state.problem = Some(problem);
        }
    }

    pub(super) fn count_rejected(&self) {
        lock(&self.state).counts.rejected += 1;
    }

    /// Sets the number of messages that exceeded the size limit.
    pub(super) fn set_oversized(&self, count: u64) {
        lock(&self.state).counts.oversized = count;
    }

    /// Sets or clears an abnormal condition.
    pub(super) fn set_condition(&self, condition: &'static str, holds: bool) {
        let mut state = lock(&self.state);
        if holds {
            state.conditions.insert(condition);
        } else {
            state.conditions.remove(condition);
        }
    }

    /// Sets the lag of the scans behind the wheel odometry, s.
    pub(super) fn set_odometry_lag(&self, lag: f64) {
        lock(&self.state).odometry_lag = Some(lag);
    }

    /// Returns the state, and clears what is collected per period.
    fn take(&self) -> State {
        let mut state = lock(&self.state);
        let (latencies, problem) = (mem::take(&mut state.latencies), state.problem.take());
        State { latencies, problem, ..state.clone() }
    }
}

/// Publishes the diagnostics.
pub(super) struct Diagnostics {
    output: Output<DiagnosticArray>,
    name: String,
    task: TaskWording,
    before: (Counts, Dropped),
}

impl Diagnostics {
    pub(super) fn new(ros: &Ros, task: TaskWording) -> Result<Self, NodeError> {
        let name = format!("{}: {}", ros.name().trim_start_matches('/'), task.title);
        Ok(Self { output: Output::new(ros, "/diagnostics")?, name, task, before: (Counts::default(), Dropped::default()) })
    }

    /// Publishes the report on the last period, which was `seconds` long.
    pub(super) fn publish(&mut self, ros: &Ros, monitor: &Monitor, dropped: Dropped, master_present: bool, seconds: f64) {
        let state = monitor.take();
        let (counts_before, dropped_before) = mem::replace(&mut self.before, (state.counts, dropped));
        let report = Report { task: self.task, state, counts_before, dropped, dropped_before, master_present, seconds };
        let (level, message) = report.summary();
        let status =
            DiagnosticStatus { level, name: self.name.clone(), message, hardware_id: String::new(), values: report.values() };
        let rosrust::Time { sec, nsec } = ros.now();
        let header = Header { stamp: Time { sec, nsec }, ..Header::default() };
        self.output.send(|| DiagnosticArray { header, status: vec![status] });
    }
}

/// The report on one period.
struct Report {
    task: TaskWording,
    state: State,
    counts_before: Counts,
    dropped: Dropped,
    dropped_before: Dropped,
    master_present: bool,
    seconds: f64,
}

impl Report {
    /// Increase of a count within the period.
    fn since(&self, count: fn(&Counts) -> u64) -> u64 {
        count(&self.state.counts) - count(&self.counts_before)
    }

    /// The level and the reasons for it.
    fn summary(&self) -> (i8, String) {
        let (answered, failed) = (self.since(|c| c.answered), self.since(|c| c.failed));
        let dropped = self.dropped.scans - self.dropped_before.scans;
        let count = |count: u64, what: &str| (count > 0).then(|| format!("{count} {what}"));
        let problem = self.state.problem.as_deref().unwrap_or_default();
        let reasons: Vec<String> = [
            (answered == 0).then(|| "no scans".into()),
            count(failed, &format!("of {answered} scans not {} ({problem})", self.task.done)),
            count(dropped, "scans dropped"),
            count(self.since(|c| c.late), "answers later than the time budget"),
            count(self.since(|c| c.rejected + c.oversized), "messages refused"),
            count(self.dropped.events - self.dropped_before.events, "messages other than scans dropped"),
            (!self.master_present).then(|| "the ROS master does not answer".into()),
        ]
        .into_iter()
        .flatten()
        .chain(self.state.conditions.iter().map(|&condition| condition.into()))
        .collect();
        match (answered > 0 && failed == answered, reasons.is_empty()) {
            (true, _) => (DiagnosticStatus::ERROR, reasons.join("; ")),
            (false, false) => (DiagnosticStatus::WARN, reasons.join("; ")),
            (false, true) => (DiagnosticStatus::OK, self.task.doing.into()),
        }
    }

    fn values(&self) -> Vec<KeyValue> {
        let counts = &self.state.counts;
        let mut latencies = self.state.latencies.clone();
        latencies.sort_unstable();
        let latency =
            |fraction| format!("{:.3}", quantile::of_sorted(&latencies, fraction).unwrap_or_default().as_secs_f64() * 1e3);
        let not_done = format!("scans not {}", self.task.done);
        let lag = self.state.odometry_lag.map(|lag| ("odometry lag [s]", format!("{lag:.2}")));
        let all = [
            ("rate [Hz]", format!("{:.1}", self.since(|c| c.answered) as f64 / self.seconds)),
            ("scans answered", counts.answered.to_string()),
            (not_done.as_str(), counts.failed.to_string()),
            ("scans dropped", self.dropped.scans.to_string()),
            ("deadline misses", counts.late.to_string()),
            ("deadline misses [%]", format!("{:.3}", 100.0 * counts.late as f64 / counts.answered.max(1) as f64)),
            ("worst overrun [ms]", format!("{:.3}", counts.worst_overrun.as_secs_f64() * 1e3)),
            ("messages refused", (counts.rejected + counts.oversized).to_string()),
            ("latency p50 [ms]", latency(0.5)),
            ("latency p99 [ms]", latency(0.99)),
            ("latency max [ms]", latency(1.0)),
        ];
        all.into_iter().chain(lag).map(|(key, value)| KeyValue { key: key.into(), value }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(counts: Counts, problem: Option<&str>) -> Report {
        Report {
            task: TaskWording { title: "scan matching", doing: "matching", done: "matched" },
            state: State { counts, problem: problem.map(Into::into), ..Default::default() },
            counts_before: Counts { answered: 10, ..Default::default() },
            dropped: Dropped::default(),
            dropped_before: Dropped::default(),
            master_present: true,
            seconds: 1.0,
        }
    }

    #[test]
    fn the_level_follows_from_the_last_period() {
        let counts = |answered, failed| Counts { answered, failed, ..Default::default() };
        assert_eq!(report(counts(50, 0), None).summary(), (DiagnosticStatus::OK, "matching".into()));
        assert_eq!(report(counts(10, 0), None).summary(), (DiagnosticStatus::WARN, "no scans".into()));
        let some = (DiagnosticStatus::WARN, "3 of 40 scans not matched (fog)".into());
        assert_eq!(report(counts(50, 3), Some("fog")).summary(), some);
        assert_eq!(report(counts(50, 40), Some("fog")).summary().0, DiagnosticStatus::ERROR);
        let unknown = Report { master_present: false, ..report(counts(50, 0), None) };
        assert_eq!(unknown.summary().0, DiagnosticStatus::WARN);
    }

    #[test]
    fn percentiles_are_measured_latencies() {
        let sorted: Vec<Duration> = (1..=100).map(Duration::from_millis).collect();
        let of = |fraction| quantile::of_sorted(&sorted, fraction).unwrap_or_default().as_millis();
        assert_eq!((of(0.5), of(0.99), of(1.0), of(0.0)), (50, 99, 100, 1));
        assert_eq!(quantile::of_sorted::<Duration>(&[], 0.5).unwrap_or_default(), Duration::ZERO);
    }
}
