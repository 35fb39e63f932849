//! Results of drives.

use std::time::Duration;

use serde_json::{Value, json};

use super::estimator::{TimedAnswer, Times};
use crate::anytime::ErrorEstimate;
use crate::anytime::mode::{ConditionRanges, Conditions, OutOfRange};
use crate::control::follower::Step;
use crate::evaluation::statistics::Statistics;
use crate::geometry::{Point, Pose2};
use crate::quantile::quantile;

/// How a drive ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// All laps are complete.
    Finished,
    /// The car hit a wall.
    Hit,
    /// The car stopped for good.
    #[default]
    Stopped,
}

impl Ending {
    /// One word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Finished => "finished",
            Self::Hit => "hit",
            Self::Stopped => "stopped",
        }
    }
}

/// A position of the car and its distance from the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trace {
    /// Position of the rear axle, m.
    pub point: Point,
    /// Distance from the path, m.
    pub error: f64,
}

/// Results of one drive.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Seed of the drive.
    pub seed: u32,
    /// How the drive ended.
    pub ending: Ending,
    /// Laps driven, including a fraction of the last one.
    pub laps: f64,
    /// Duration of the drive, s.
    pub seconds: f64,
    /// The path of the car.
    pub trace: Vec<Trace>,
    /// True distances from the path, m, every 10 ms.
    errors: Vec<f64>,
    /// Time at the end of each lap, s.
    lap_ends: Vec<f64>,
    /// Age of the pose when each command takes effect, s.
    ages: Vec<f64>,
    /// Number of answers.
    pub answers: u64,
    /// Number of answers that overran their contract.
    pub late: u64,
    /// Number of answers that came after the next scan.
    pub overdue: u64,
    /// Number of answers that are only predictions.
    pub failed: u64,
    /// Number of scans that were dropped because a newer one arrived.
    pub dropped: u64,
    /// Processor time of the estimator.
    pub work: Duration,
    /// Number of commands that braked the car or held it.
    pub stops: u64,
    /// Reason of the first such command.
    pub first_stop: Option<String>,
    /// Largest lateral jump of the followed line when a new path arrived, m.
    pub line_jump: f64,
    /// Conditions of the answers.
    conditions: Vec<Conditions>,
    /// Number of answers under conditions outside those of the policy's table.
    pub outside: u64,
    /// The first such deviation.
    pub first_outside: Option<OutOfRange>,
    poses: u64,
    squared_pose_errors: f64,
    worst_pose_error: f64,
    /// Sums of the squared pose errors that affect the controller: lateral, m^2, and heading, rad^2.
    squared_lateral_and_heading: [f64; 2],
}

impl Run {
    pub(super) fn new(seed: u32) -> Self {
        Self { seed, ..Self::default() }
    }

    /// Whether all laps were completed.
    pub fn is_finished(&self) -> bool {
        self.ending == Ending::Finished
    }

    /// Drops the details that the summary does not need, and the trace unless `keep_trace`.
    pub(super) fn drop_details(&mut self, keep_trace: bool) {
        (self.errors, self.ages, self.conditions) = (Vec::new(), Vec::new(), Vec::new());
        if !keep_trace {
            self.trace = Vec::new();
        }
    }

    /// RMS lateral and heading errors of the poses.
    pub(super) fn lateral_and_heading_error(&self) -> ErrorEstimate {
        let [translation, rotation] = self.squared_lateral_and_heading.map(|sum| (sum / self.poses.max(1) as f64).sqrt());
        ErrorEstimate { translation, rotation }
    }

    /// Ranges of the conditions of nearly all answers.
    pub(super) fn conditions(&self) -> ConditionRanges {
        ConditionRanges::of(self.conditions.iter().copied())
    }

    pub(super) fn add_outside(&mut self, outside: OutOfRange) {
        self.outside += 1;
        self.first_outside.get_or_insert(outside);
    }

    pub(super) fn add_error(&mut self, error: f64) {
        self.errors.push(error);
    }

    pub(super) fn add_answer(&mut self, answer: &TimedAnswer, times: Times, truth: &Pose2) {
        // A filter without a belief gives no pose: its deviation is infinite.
        if answer.reading.deviation.is_finite() {
            self.poses += 1;
            let error = truth.between(&answer.reading.pose);
            self.squared_pose_errors += error.distance().powi(2);
            self.worst_pose_error = self.worst_pose_error.max(error.distance());
            self.squared_lateral_and_heading[0] += error.y.powi(2);
            self.squared_lateral_and_heading[1] += error.theta.powi(2);
        }
        self.answers += 1;
        self.late += u64::from(answer.is_late);
        self.overdue += u64::from(answer.ready_at > times.next);
        self.failed += u64::from(!answer.is_ok);
        self.conditions.extend(answer.conditions);
        self.work += answer.work;
    }

    /// Commands before the first pose do not count: the car can only wait.
    pub(super) fn add_step(&mut self, step: &Step) {
        let Some(age) = step.pose_age else { return };
        self.ages.push(age);
        if let Some(stop) = step.stop {
            self.stops += 1;
            self.first_stop.get_or_insert_with(|| stop.to_string());
        }
    }

    pub(super) fn count_laps(&mut self, now: u64, driven: f64, length: f64) {
        if driven >= (self.lap_ends.len() + 1) as f64 * length {
            self.lap_ends.push(now as f64 * 1e-3);
        }
    }
}

/// Statistics over all drives of a case.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Number of drives.
    pub runs: usize,
    /// Number of drives that finished.
    pub finished: usize,
    /// Number of drives that hit a wall.
    pub hits: usize,
    /// Laps of all drives, including fractions.
    pub laps: f64,
    /// True distance from the path, m: mean, RMS, 99.9th percentile and maximum.
    pub lateral: [f64; 4],
    /// Position error of the poses at their stamps, m: RMS and maximum. The rest of the lateral error is due to the follower and
    /// to delays.
    pub pose: [f64; 2],
    /// Mean lap time without the first lap, s; of the first lap if there is no other.
    pub lap_time: f64,
    /// Fraction of the answers that overran their contract.
    pub late: f64,
    /// Fraction of the answers that came after the next scan.
    pub overdue: f64,
    /// Fraction of the answers that were only predictions.
    pub failed: f64,
    /// Fraction of the scans that were dropped.
    pub dropped: f64,
    /// Age of the pose when a command takes effect, s: mean and 99th percentile.
    pub age: [f64; 2],
    /// Processor time of the estimator per lap, s.
    pub work_per_lap: f64,
    /// Fraction of the commands that braked the car or held it.
    pub stopped: f64,
    /// Reason of the first such command.
    pub first_stop: Option<String>,
    /// Largest lateral jump of the followed line when a new path arrived, m.
    pub line_jump: f64,
    /// Fraction of the answers under conditions outside those of the policy's table.
    pub outside: f64,
    /// The first such deviation, as text.
    pub first_outside: Option<String>,
}

impl Figures {
    /// Statistics of some drives.
    pub fn of(runs: &[Run]) -> Self {
        let sum = |count: fn(&Run) -> u64| runs.iter().map(count).sum::<u64>() as f64;
        let (answers, dropped) = (sum(|run| run.answers).max(1.0), sum(|run| run.dropped));
        let laps: f64 = runs.iter().map(|run| run.laps).sum();
        let work: f64 = runs.iter().map(|run| run.work.as_secs_f64()).sum();
        let commands = runs.iter().map(|run| run.ages.len()).sum::<usize>().max(1) as f64;
        let ages: Vec<f64> = runs.iter().flat_map(|run| run.ages.iter().copied()).collect();
        Self {
            runs: runs.len(),
            finished: runs.iter().filter(|run| run.is_finished()).count(),
            hits: runs.iter().filter(|run| run.ending == Ending::Hit).count(),
            laps,
            lateral: lateral(runs.iter().flat_map(|run| run.errors.iter().copied()).collect()),
            pose: pose_errors(runs),
            lap_time: lap_time(runs),
            late: sum(|run| run.late) / answers,
            overdue: sum(|run| run.overdue) / answers,
            failed: sum(|run| run.failed) / answers,
            dropped: dropped / (answers + dropped),
            age: [mean(ages.clone()), percentile(ages, 0.99)],
            work_per_lap: work / laps.max(1e-9),
            stopped: sum(|run| run.stops) / commands,
            first_stop: runs.iter().find_map(|run| run.first_stop.clone()),
            line_jump: runs.iter().map(|run| run.line_jump).fold(0.0, f64::max),
            outside: sum(|run| run.outside) / answers,
            first_outside: runs.iter().find_map(|run| run.first_outside).map(|outside| outside.to_string()),
        }
    }

    /// The statistics as JSON.
    pub fn to_json(&self) -> Value {
        json!({
            "runs": self.runs,
            "finished": self.finished,
            "wall_hits": self.hits,
            "laps": self.laps,
            "lateral_error_m": {
                "mean": self.lateral[0], "rms": self.lateral[1], "p99_9": self.lateral[2], "max": self.lateral[3],
            },
            "pose_error_m": {"rms": self.pose[0], "max": self.pose[1]},
            "lap_time_s": self.lap_time,
            "late_answers": self.late,
            "answers_after_next_scan": self.overdue,
            "failed_answers": self.failed,
            "dropped_scans": self.dropped,
            "pose_age_s": {"mean": self.age[0], "p99": self.age[1]},
            "processor_s_per_lap": self.work_per_lap,
            "stopped": self.stopped,
            "first_stop": self.first_stop,
            "path_step_m": self.line_jump,
            "outside_profile": self.outside,
            "first_outside_profile": self.first_outside,
        })
    }
}

/// How each drive ended, as JSON.
pub(super) fn endings(runs: &[Run]) -> Value {
    runs.iter()
        .map(|run| json!({"seed": run.seed, "ending": run.ending.name(), "laps": run.laps, "seconds": run.seconds}))
        .collect()
}

/// The value that a fraction of the values does not exceed; 0 without values.
fn percentile(mut values: Vec<f64>, fraction: f64) -> f64 {
    quantile(&mut values, fraction, f64::total_cmp).unwrap_or_default()
}

fn lateral(errors: Vec<f64>) -> [f64; 4] {
    let Some(Statistics { mean, rmse, max, .. }) = Statistics::of(errors.clone()) else { return [0.0; 4] };
    [mean, rmse, percentile(errors, 0.999), max]
}

fn mean(values: Vec<f64>) -> f64 {
    Statistics::of(values).map_or(0.0, |statistics| statistics.mean)
}

fn pose_errors(runs: &[Run]) -> [f64; 2] {
    let squares: f64 = runs.iter().map(|run| run.squared_pose_errors).sum();
    let poses = runs.iter().map(|run| run.poses).sum::<u64>().max(1);
    [(squares / poses as f64).sqrt(), runs.iter().map(|run| run.worst_pose_error).fold(0.0, f64::max)]
}

fn lap_time(runs: &[Run]) -> f64 {
    let later: Vec<f64> = runs.iter().flat_map(|run| run.lap_ends.windows(2).map(|ends| ends[1] - ends[0])).collect();
    let first: Vec<f64> = runs.iter().filter_map(|run| run.lap_ends.first().copied()).collect();
    mean(if later.is_empty() { first } else { later })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_combine_all_runs() {
        let run = |seed: u32, errors: &[f64], ending: Ending| Run {
            errors: errors.to_vec(),
            ending,
            laps: 2.0,
            lap_ends: vec![12.0, 22.0],
            work: Duration::from_secs(3),
            answers: 10,
            late: 1,
            ..Run::new(seed)
        };
        let figures = Figures::of(&[run(1, &[0.0, 0.1], Ending::Finished), run(2, &[0.2, 0.1], Ending::Hit)]);
        assert_eq!((figures.runs, figures.finished, figures.hits), (2, 1, 1));
        assert!((figures.lateral[0] - 0.1).abs() < 1e-12 && (figures.lateral[1] - 0.015_f64.sqrt()).abs() < 1e-12);
        assert_eq!((figures.lateral[3], figures.lap_time, figures.work_per_lap, figures.late), (0.2, 10.0, 1.5, 0.1));
        assert_eq!(Figures::of(&[]).to_json()["runs"], 0);
    }
}
