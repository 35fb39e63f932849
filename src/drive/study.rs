//! A study of many drives: every policy at every speed and load, with several seeds.

use std::path::PathBuf;

use comfy_table::presets;
use serde_json::{Value, json};

use super::closed_loop::{Setup, drive};
use super::course::Course;
use super::figures::{Figures, Run, endings};
use super::flaws::FlawKnobs;
use super::processor::Load;
use super::{DriveError, EstimatorKind, costs, profiling};
use crate::anytime::mode::Mode;
use crate::config::Config;
use crate::control::follower::FollowerKnobs;
use crate::control::policy::{Policy, Table};
use crate::parallel;
use crate::simulation::lidar::LidarKnobs;
use crate::simulation::odometer::OdometerKnobs;

pub use super::replanning::Replanning;

/// A combination of the varied settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// How contracts are chosen.
    pub policy: Policy,
    /// Top speed, m/s.
    pub speed: f64,
    /// The load of the machine.
    pub load: Load,
}

/// Results of a case.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// Statistics over all seeds.
    pub figures: Figures,
    /// All drives. Traces are kept only of the first drive and of the first one that did not finish.
    pub runs: Vec<Run>,
}

/// Settings of a study.
pub struct Study<'a> {
    /// Where to drive.
    pub course: &'a Course,
    /// Source of the poses.
    pub estimator: EstimatorKind,
    /// Configuration of the estimator.
    pub config: &'a Config,
    /// Parameters of the follower; each case overrides the speed.
    pub follower: FollowerKnobs,
    /// Parameters of the laser.
    pub lidar: LidarKnobs,
    /// Parameters of the wheel odometry.
    pub odometer: OdometerKnobs,
    /// Model errors of the car.
    pub flaws: FlawKnobs,
    /// File with the costs of the machine; `None`: built-in costs.
    pub costs: Option<PathBuf>,
    /// Planner with delayed paths; `None`: the path is known from the start.
    pub replanning: Option<Replanning>,
    /// Laps per drive.
    pub laps: u32,
    /// Drives per case.
    pub seeds: u32,
    /// Seed of the first drive of a case; each further drive adds 1.
    pub first_seed: u32,
    /// Policies to compare.
    pub policies: Vec<Policy>,
    /// Top speeds, m/s.
    pub speeds: Vec<f64>,
    /// Loads of the machine.
    pub loads: Vec<Load>,
    /// The command line.
    pub command: String,
}

impl Study<'_> {
    /// Runs all drives. `on_run` is called after each drive.
    pub fn conduct(&self, on_run: impl Fn() + Sync) -> Result<Vec<Outcome>, DriveError> {
        if !self.course.path.is_closed() && self.laps > 1 {
            return Err(DriveError::OpenPath);
        }
        let mut outcomes = Vec::new();
        for &load in &self.loads {
            for &speed in &self.speeds {
                for policy in &self.policies {
                    let case = Case { policy: policy.clone(), speed, load };
                    outcomes.push(self.drive_case(case, &on_run)?);
                }
            }
        }
        Ok(outcomes)
    }

    /// Total number of drives.
    pub fn runs(&self) -> u64 {
        (self.policies.len() * self.speeds.len() * self.loads.len()) as u64 * u64::from(self.seeds)
    }

    fn setup(&self, case: &Case, seed: u32) -> Result<Setup<'_>, DriveError> {
        Ok(Setup {
            course: self.course,
            estimator: self.estimator,
            config: self.config,
            follower: FollowerKnobs { speed: case.speed, ..self.follower.clone() },
            lidar: self.lidar.clone(),
            odometer: self.odometer.clone(),
            flaws: self.flaws.clone(),
            costs: costs::load(self.estimator, self.costs.as_deref(), self.config.contract.confidence)?,
            load: case.load,
            policy: case.policy.clone(),
            replanning: self.replanning,
            laps: self.laps,
            seed,
            steer_by_truth: false,
        })
    }

    fn drive_case(&self, mut case: Case, on_run: &(impl Fn() + Sync)) -> Result<Outcome, DriveError> {
        if case.policy == Policy::Table(Table::default()) {
            case.policy = Policy::Table(profiling::table(&self.setup(&case, self.first_seed)?)?);
        }
        let run = |seed: u32| {
            let run = self.setup(&case, seed).and_then(|setup| drive(&setup));
            on_run();
            run
        };
        let mut runs: Vec<Run> = parallel::map((0..self.seeds).map(|drive| self.first_seed.wrapping_add(drive)), run)
            .into_iter()
            .collect::<Result<_, _>>()?;
        let figures = Figures::of(&runs);
        let shown = runs.iter().position(|run| !run.is_finished()).unwrap_or(0);
        for (index, run) in runs.iter_mut().enumerate() {
            run.drop_details(index == 0 || index == shown);
        }
        Ok(Outcome { case, figures, runs })
    }

    /// Settings of the study as (name, value). The names are also JSON keys.
    pub(super) fn facts(&self) -> Vec<(&'static str, String)> {
        vec![
            ("world", self.course.name.clone()),
            (
                "path",
                format!("{:.1} m, {}", self.course.path.length(), if self.course.path.is_closed() { "closed" } else { "open" }),
            ),
            ("estimator", self.estimator.name().into()),
            ("law", self.follower.law.name().into()),
            ("laps, seeds", format!("{} laps, {} seeds starting at {}", self.laps, self.seeds, self.first_seed)),
            ("laser", format!("{} beams at {} Hz", self.lidar.beams, self.lidar.rate)),
            (
                "flaws of the car, standard deviations",
                format!(
                    "steering {} deg and {} %, speed {} %",
                    self.flaws.steering_offset,
                    100.0 * self.flaws.steering_scale,
                    100.0 * self.flaws.speed_scale
                ),
            ),
            ("costs", self.costs.as_ref().map_or("built in".into(), |path| path.display().to_string())),
            (
                "late paths",
                self.replanning.map_or("none".into(), |planner| {
                    format!("{} Hz, delay {} s, length {} m", planner.rate, planner.delay, planner.horizon)
                }),
            ),
            (
                "emergency brake",
                if self.follower.min_time_to_collision.0 > 0.0 { "on" } else { "off, so that it does not hide collisions" }
                    .into(),
            ),
            ("program", format!("anytime_scan_matcher {}", env!("CARGO_PKG_VERSION"))),
        ]
    }

    /// The results as JSON.
    pub fn to_json(&self, outcomes: &[Outcome]) -> Value {
        let case = |outcome: &Outcome| {
            let Case { policy, speed, load } = &outcome.case;
            let mut value = outcome.figures.to_json();
            value["policy"] = policy.to_string().into();
            value["speed_m_s"] = (*speed).into();
            value["slowdown"] = load.slowdown.into();
            value["bursts"] = load.bursts.into();
            if let Policy::Table(table) = policy {
                value["modes"] = table.modes.iter().map(mode).collect();
            }
            value["drives"] = endings(&outcome.runs);
            value
        };
        let facts: serde_json::Map<_, _> =
            self.facts().into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect();
        json!({"command": self.command, "facts": facts, "cases": outcomes.iter().map(case).collect::<Vec<_>>()})
    }
}

/// A mode as JSON.
fn mode(&Mode { delay, error }: &Mode) -> Value {
    json!({"delay_s": delay.as_secs_f64(), "error_m": error.translation, "heading_error_rad": error.rotation})
}

impl std::fmt::Display for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} at {} m/s, x{}", self.policy, self.speed, self.load.slowdown)?;
        if self.load.bursts > 1.0 { write!(f, ", bursts x{}", self.load.bursts) } else { Ok(()) }
    }
}

/// Header of the results table.
pub(super) const HEADER: [&str; 15] = [
    "policy",
    "speed",
    "load",
    "finished",
    "hits",
    "laps",
    "mean [cm]",
    "RMS [cm]",
    "p99.9 [cm]",
    "max [cm]",
    "pose [cm]",
    "lap [s]",
    "late [%]",
    "age [ms]",
    "cpu/lap [s]",
];

/// A row of the results table.
pub(super) fn row(outcome: &Outcome) -> Vec<String> {
    let Outcome { case, figures, .. } = outcome;
    let centimetres = figures.lateral.map(|error| format!("{:.1}", 100.0 * error));
    let bursts = if case.load.bursts > 1.0 { format!(", bursts x{}", case.load.bursts) } else { String::new() };
    let mut row = vec![
        case.policy.to_string(),
        format!("{} m/s", case.speed),
        format!("x{}{bursts}", case.load.slowdown),
        format!("{} of {}", figures.finished, figures.runs),
        figures.hits.to_string(),
        format!("{:.1}", figures.laps),
    ];
    row.extend(centimetres);
    row.push(format!("{:.1}", 100.0 * figures.pose[0]));
    row.push(format!("{:.2}", figures.lap_time));
    row.push(format!("{:.2}", 100.0 * figures.late.max(if case.policy == Policy::Completion { figures.overdue } else { 0.0 })));
    row.push(format!("{:.1}", 1e3 * figures.age[0]));
    row.push(format!("{:.3}", figures.work_per_lap));
    row
}

/// The results as a text table.
pub fn to_text(outcomes: &[Outcome]) -> String {
    let mut table = comfy_table::Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(HEADER);
    for outcome in outcomes {
        table.add_row(row(outcome));
    }
    remarks(outcomes).iter().fold(table.to_string(), |text, remark| text + "\n" + remark)
}

/// Remarks below the results table.
pub(super) fn remarks(outcomes: &[Outcome]) -> Vec<String> {
    let mut remarks = Vec::new();
    for Outcome { case, figures, .. } in outcomes {
        if let Some(reason) = &figures.first_stop {
            let percent = 100.0 * figures.stopped;
            remarks.push(format!("{case}: {percent:.1} % of the commands braked or held the car; first reason: {reason}"));
        }
        if let Some(outside) = &figures.first_outside {
            let percent = 100.0 * figures.outside;
            remarks.push(format!(
                "{case}: warning: {percent:.1} % of the answers are outside the conditions of the profile: {outside}"
            ));
        }
        if figures.line_jump > 0.0 {
            let centimetres = 100.0 * figures.line_jump;
            remarks.push(format!("{case}: new paths shifted the followed line sideways by at most {centimetres:.1} cm"));
        }
    }
    remarks
}
