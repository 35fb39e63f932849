//! What came of drives.

use std::time::Duration;

use serde_json::{Value, json};

use super::estimator::{Answer, Times};
use crate::anytime::ErrorEstimate;
use crate::anytime::mode::{Conditions, Outside, Ranges};
use crate::control::follower::Step;
use crate::evaluation::statistics::Statistics;
use crate::geometry::{Point, Pose2};
use crate::quantile::quantile;

/// How a drive ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All laps are done.
    Finished,
    /// At a wall.
    Hit,
    /// The car has stopped, and does not go on.
    Stopped,
}

impl Ending {
    fn name(self) -> &'static str {
        match self {
            Self::Finished => "finished",
            Self::Hit => "hit",
            Self::Stopped => "stopped",
        }
    }
}

/// A place of the car and its distance from the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trace {
    /// m.
    pub point: Point,
    /// m.
    pub error: f64,
}

/// One drive.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its seed.
    pub seed: u32,
    /// How it ended.
    pub ending: Ending,
    /// Laps, with fractions.
    pub laps: f64,
    /// How long it took, s.
    pub seconds: f64,
    /// The way of the car.
    pub trace: Vec<Trace>,
    /// True distances from the path, m, every 10 ms.
    errors: Vec<f64>,
    /// When each lap was done, s.
    lap_ends: Vec<f64>,
    /// Ages of the poses when the commands act, s.
    ages: Vec<f64>,
    /// Answers.
    pub answers: u64,
    /// Of these, later than their contract.
    pub late: u64,
    /// Of these, later than the next scan.
    pub overdue: u64,
    /// Of these, predictions.
    pub failed: u64,
    /// Scans that were not taken up: a newer one was there.
    pub dropped: u64,
    /// Processor time of the estimator.
    pub work: Duration,
    /// Commands to brake or stand.
    pub stops: u64,
    /// The first reason for one.
    pub first_stop: Option<String>,
    /// The largest step of the followed line when a path came, m.
    pub step_aside: f64,
    /// What the answers found.
    conditions: Vec<Conditions>,
    /// Answers in other conditions than the table's, and what was first other there.
    pub outside: u64,
    /// The first.
    pub first_outside: Option<Outside>,
    poses: u64,
    squared_pose_errors: f64,
    worst_pose_error: f64,
    /// Sums of squares of what a controller notices of them: across the direction of travel, m^2, and of the heading, rad^2.
    squared_noticed: [f64; 2],
}

impl Run {
    pub(super) fn new(seed: u32) -> Self {
        Self {
            seed,
            ending: Ending::Stopped,
            laps: 0.0,
            seconds: 0.0,
            trace: Vec::new(),
            errors: Vec::new(),
            lap_ends: Vec::new(),
            ages: Vec::new(),
            answers: 0,
            late: 0,
            overdue: 0,
            failed: 0,
            dropped: 0,
            work: Duration::ZERO,
            stops: 0,
            first_stop: None,
            step_aside: 0.0,
            conditions: Vec::new(),
            outside: 0,
            first_outside: None,
            poses: 0,
            squared_pose_errors: 0.0,
            worst_pose_error: 0.0,
            squared_noticed: [0.0; 2],
        }
    }

    /// Whether all laps were done.
    pub fn is_finished(&self) -> bool {
        self.ending == Ending::Finished
    }

    /// How it ended, in a word.
    pub fn ending_name(&self) -> &'static str {
        self.ending.name()
    }

    /// Keeps what sums it up, and its way if asked to.
    pub(super) fn forget_details(&mut self, keep_trace: bool) {
        (self.errors, self.ages, self.conditions) = (Vec::new(), Vec::new(), Vec::new());
        if !keep_trace {
            self.trace = Vec::new();
        }
    }

    /// RMS errors of the poses: across the direction of travel, and of the heading.
    pub(super) fn noticed_error(&self) -> ErrorEstimate {
        let [translation, rotation] = self.squared_noticed.map(|sum| (sum / self.poses.max(1) as f64).sqrt());
        ErrorEstimate { translation, rotation }
    }

    /// The conditions of nearly all answers.
    pub(super) fn conditions(&self) -> Ranges {
        Ranges::of(self.conditions.iter().copied())
    }

    pub(super) fn add_outside(&mut self, outside: Outside) {
        self.outside += 1;
        self.first_outside.get_or_insert(outside);
    }

    pub(super) fn add_error(&mut self, error: f64) {
        self.errors.push(error);
    }

    pub(super) fn add_answer(&mut self, answer: &Answer, times: Times, truth: &Pose2) {
        // A filter that knows nothing gives no pose.
        if answer.reading.deviation.is_finite() {
            self.poses += 1;
            let off = truth.between(&answer.reading.pose);
            self.squared_pose_errors += off.distance().powi(2);
            self.worst_pose_error = self.worst_pose_error.max(off.distance());
            self.squared_noticed[0] += off.y.powi(2);
            self.squared_noticed[1] += off.theta.powi(2);
        }
        self.answers += 1;
        self.late += u64::from(answer.is_late);
        self.overdue += u64::from(answer.ready > times.next);
        self.failed += u64::from(!answer.is_ok);
        self.conditions.extend(answer.conditions);
        self.work += answer.work;
    }

    /// Before the first pose there is nothing to be done but to stand.
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

/// All drives of a case.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Drives.
    pub runs: usize,
    /// Those that finished.
    pub finished: usize,
    /// Those that ended at a wall.
    pub hits: usize,
    /// Laps of all, with fractions.
    pub laps: f64,
    /// True distance from the path, m: mean, RMS, 99.9 % and most.
    pub lateral: [f64; 4],
    /// Distance of the poses from the truth at their stamps, m: RMS and most. The rest of the lateral error is the follower's, and of delays.
    pub pose: [f64; 2],
    /// Mean time of a lap from the second on, else of the first, s.
    pub lap_time: f64,
    /// Part of the answers that were later than their contract.
    pub late: f64,
    /// Part of the answers that came after the next scan.
    pub overdue: f64,
    /// Part of the answers that were predictions.
    pub failed: f64,
    /// Part of the scans that were not taken up.
    pub dropped: f64,
    /// Age of the poses when commands act, s: mean and 99 %.
    pub age: [f64; 2],
    /// Processor time of the estimator for a lap, s.
    pub work_per_lap: f64,
    /// Part of the commands that braked or stood.
    pub stopped: f64,
    /// The first reason for one.
    pub first_stop: Option<String>,
    /// The largest step of the followed line when a path came, m.
    pub step_aside: f64,
    /// Part of the answers in other conditions than the table's.
    pub outside: f64,
    /// What was first other there.
    pub first_outside: Option<String>,
}

impl Figures {
    /// Of some drives.
    pub fn of(runs: &[Run]) -> Self {
        let sum = |count: fn(&Run) -> u64| runs.iter().map(count).sum::<u64>() as f64;
        let (answers, dropped) = (sum(|run| run.answers).max(1.0), sum(|run| run.dropped));
        let laps: f64 = runs.iter().map(|run| run.laps).sum();
        let work: f64 = runs.iter().map(|run| run.work.as_secs_f64()).sum();
        let commands = runs.iter().map(|run| run.ages.len()).sum::<usize>().max(1) as f64;
        let ages: Vec<f64> = runs.iter().flat_map(|run| run.ages.iter().copied()).collect();
        Self {
            runs: runs.len(),
            finished: runs.iter().filter(|run| run.ending == Ending::Finished).count(),
            hits: runs.iter().filter(|run| run.ending == Ending::Hit).count(),
            laps,
            lateral: lateral(runs.iter().flat_map(|run| run.errors.iter().copied()).collect()),
            pose: pose_errors(runs),
            lap_time: lap_time(runs),
            late: sum(|run| run.late) / answers,
            overdue: sum(|run| run.overdue) / answers,
            failed: sum(|run| run.failed) / answers,
            dropped: dropped / (answers + dropped),
            age: [mean(ages.clone()), at_share(ages, 0.99)],
            work_per_lap: work / laps.max(1e-9),
            stopped: sum(|run| run.stops) / commands,
            first_stop: runs.iter().find_map(|run| run.first_stop.clone()),
            step_aside: runs.iter().map(|run| run.step_aside).fold(0.0, f64::max),
            outside: sum(|run| run.outside) / answers,
            first_outside: runs.iter().find_map(|run| run.first_outside).map(|outside| outside.to_string()),
        }
    }

    /// For machines.
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
            "path_step_m": self.step_aside,
            "outside_profile": self.outside,
            "first_outside_profile": self.first_outside,
        })
    }
}

/// For machines: how each ended.
pub(super) fn endings(runs: &[Run]) -> Value {
    runs.iter()
        .map(|run| json!({"seed": run.seed, "ending": run.ending.name(), "laps": run.laps, "seconds": run.seconds}))
        .collect()
}

/// The least value that so large a share does not exceed.
fn at_share(mut values: Vec<f64>, share: f64) -> f64 {
    quantile(&mut values, share, f64::total_cmp).unwrap_or_default()
}

fn lateral(errors: Vec<f64>) -> [f64; 4] {
    let Some(Statistics { mean, rmse, max, .. }) = Statistics::of(errors.clone()) else { return [0.0; 4] };
    [mean, rmse, at_share(errors, 0.999), max]
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
    let flying: Vec<f64> = runs.iter().flat_map(|run| run.lap_ends.windows(2).map(|ends| ends[1] - ends[0])).collect();
    let first: Vec<f64> = runs.iter().filter_map(|run| run.lap_ends.first().copied()).collect();
    mean(if flying.is_empty() { first } else { flying })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_all_runs_together() {
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
