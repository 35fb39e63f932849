//! `anytime drive`.

use std::path::{Path, PathBuf};

use anytime_scan_matcher::control::follower::FollowerKnobs;
use anytime_scan_matcher::control::laws::Law;
use anytime_scan_matcher::control::policy::Policy;
use anytime_scan_matcher::drive::EstimatorKind;
use anytime_scan_matcher::drive::course::Course;
use anytime_scan_matcher::drive::flaws::FlawKnobs;
use anytime_scan_matcher::drive::processor::Load;
use anytime_scan_matcher::drive::study::{Replanning, Study, to_text};
use anytime_scan_matcher::knobs::{KnobGroup as _, KnobValue, Seconds, Value};
use anytime_scan_matcher::simulation::lidar::LidarKnobs;
use anytime_scan_matcher::simulation::odometer::OdometerKnobs;
use clap::Args;

use crate::configuration::Configuration;
use crate::files::{Files, create_folder};
use crate::knob_flags::{help, set, value};
use crate::outcome::usage;
use crate::simulation_flags::check_world;
use crate::{progress, terminal};

/// Drive a simulated racecar closed-loop on its own pose estimates: simulator, estimator and path follower in one process, on a
/// simulated clock
#[derive(Args)]
pub(crate) struct Arguments {
    /// The environment: corridor, room, or the YAML file of a map
    #[arg(long, default_value = "corridor")]
    world: String,
    /// The path: a CSV file of waypoints x, y[, speed] [default: a closed path is planned]
    #[arg(long, value_name = "FILE.csv")]
    path: Option<PathBuf>,
    /// Laps per drive
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    laps: u32,
    /// Top speed, m/s; several values, separated by commas, are each driven
    #[arg(long, default_value = "7", value_delimiter = ',')]
    speed: Vec<f64>,
    /// The source of the poses: `truth`, `scan_matcher` or `particle_filter`
    #[arg(long, default_value = "scan_matcher", value_parser = |text: &str| EstimatorKind::from_value(&text.into()))]
    estimator: EstimatorKind,
    #[arg(long, default_value = FollowerKnobs::default().law.name(), hide_default_value = true, value_parser = |text: &str| Law::from_value(&text.into()), help = help::<FollowerKnobs>("law"))]
    law: Law,
    /// How contracts are chosen: `completion`, `iterations:N`, `fixed:TIME[,METRES]`, `table`, `oracle`; may be repeated
    #[arg(long, default_value = "completion")]
    policy: Vec<Policy>,
    /// Slow-down of the machine relative to the costs (`8` or `x8`); several values, separated by commas, are each driven
    #[arg(long, default_value = "1", value_delimiter = ',', value_parser = factor)]
    slowdown: Vec<f64>,
    /// Load by other programs for 0.4 s in every 1.2 s: during a burst all work takes this many times as long (`x20`); several
    /// values, separated by commas, are each driven
    #[arg(long, default_value = "1", value_delimiter = ',', value_parser = factor)]
    bursts: Vec<f64>,
    /// Costs of the estimator: a file of `contract.cost_file` [default: those of the machine of docs/figures.md]
    #[arg(long, value_name = "FILE.yaml")]
    costs: Option<PathBuf>,
    /// Number of drives per case
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    seeds: u32,
    /// Seed of the first drive; each further drive adds 1
    #[arg(long, default_value_t = 1)]
    seed: u32,
    /// Rate at which a planner publishes new paths, Hz; 0: one path, available from the start
    #[arg(long, default_value_t = 0.0)]
    replan: f64,
    /// Delay of the planner's paths, such as 2s
    #[arg(long, default_value = "0", value_parser = seconds, allow_hyphen_values = true)]
    path_delay: f64,
    /// Length of the planner's paths, m
    #[arg(long, default_value_t = 40.0)]
    horizon: f64,
    #[arg(long, value_parser = value, help = help::<FlawKnobs>("steering_offset"))]
    steering_offset: Option<Value>,
    #[arg(long, value_parser = value, help = help::<FlawKnobs>("steering_scale"))]
    steering_scale: Option<Value>,
    #[arg(long, value_parser = value, help = help::<FlawKnobs>("speed_scale"))]
    speed_scale: Option<Value>,
    /// Number of beams of the laser
    #[arg(long, default_value_t = LidarKnobs::default().beams, value_parser = clap::value_parser!(u32).range(10..=10_000))]
    beams: u32,
    /// Set a parameter of the path follower, such as `lookahead_time=0.3` (all: `path_follower --help`); may be repeated
    #[arg(long, value_name = "NAME=VALUE")]
    follow: Vec<String>,
    /// The folder for report.html, figures.json and plots
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    configuration: Configuration,
}

/// `20` or `x20`.
fn factor(text: &str) -> Result<f64, String> {
    let number: Option<f64> = text.trim_start_matches('x').parse().ok();
    number
        .filter(|factor| (1e-3..=1e6).contains(factor))
        .ok_or_else(|| "expected a factor from 0.001 to 1000000, such as x20".into())
}

fn seconds(text: &str) -> Result<f64, String> {
    let Ok(value) = value(text);
    Seconds::from_value(&value)
        .map(|seconds| seconds.0)
        .and_then(|seconds| if seconds >= 0.0 { Ok(seconds) } else { Err("expected at least 0".into()) })
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let mut config = arguments.configuration.load()?;
    check_files(arguments)?;
    // Drives run in parallel, one core each.
    config.localization.threads = 1;
    check_world(&arguments.world)?;
    let course = Course::load(&arguments.world, arguments.path.as_deref())?;
    let loads =
        arguments.slowdown.iter().flat_map(|&slowdown| arguments.bursts.iter().map(move |&bursts| Load { slowdown, bursts }));
    let study = Study {
        course: &course,
        estimator: arguments.estimator,
        config: &config,
        follower: follower(arguments)?,
        lidar: LidarKnobs { beams: arguments.beams, ..LidarKnobs::default() },
        odometer: OdometerKnobs::default(),
        flaws: flaws(arguments)?,
        costs: arguments.costs.clone(),
        replanning: replanning(arguments)?,
        laps: arguments.laps,
        seeds: arguments.seeds,
        first_seed: arguments.seed,
        policies: arguments.policy.clone(),
        speeds: arguments.speed.clone(),
        loads: loads.collect(),
        command: terminal::command_line(),
    };
    if let Some(out) = &arguments.out {
        create_folder(out)?;
    }
    let progress = progress::bar(study.runs())?;
    let outcomes = study.conduct(|| progress.inc(1))?;
    progress.finish_and_clear();
    if let Some(out) = &arguments.out {
        study.write(&outcomes, out)?;
        eprintln!("wrote {}", out.display());
    }
    Ok(if arguments.json { study.to_json(&outcomes).to_string() } else { to_text(&outcomes) })
}

/// The defaults with the control law and the values of `--follow`. The emergency brake is off unless `--follow` sets it.
fn follower(arguments: &Arguments) -> anyhow::Result<FollowerKnobs> {
    let mut knobs = FollowerKnobs { law: arguments.law, min_time_to_collision: Seconds(0.0), ..FollowerKnobs::default() };
    for assignment in &arguments.follow {
        let (name, text) =
            assignment.split_once('=').ok_or_else(|| usage(format!("--follow {assignment}: expected NAME=VALUE")))?;
        let Ok(value) = value(text);
        match knobs.set(name, &value) {
            Some(Ok(())) => {}
            Some(Err(problem)) => return Err(usage(format!("--follow {name}: {problem}"))),
            None => return Err(usage(format!("--follow {name}: the path follower has no such parameter"))),
        }
    }
    if let Some(speed) = arguments.speed.iter().find(|speed| !(0.1..=20.0).contains(*speed)) {
        return Err(usage(format!("--speed {speed}: expected 0.1 to 20")));
    }
    Ok(knobs)
}

fn flaws(arguments: &Arguments) -> anyhow::Result<FlawKnobs> {
    let mut knobs = FlawKnobs::default();
    set(&mut knobs, "steering_offset", arguments.steering_offset.as_ref())?;
    set(&mut knobs, "steering_scale", arguments.steering_scale.as_ref())?;
    set(&mut knobs, "speed_scale", arguments.speed_scale.as_ref())?;
    Ok(knobs)
}

fn replanning(arguments: &Arguments) -> anyhow::Result<Option<Replanning>> {
    let &Arguments { replan, path_delay, horizon, .. } = arguments;
    if !((0.0..=1000.0).contains(&replan) && (1.0..=1000.0).contains(&horizon)) {
        return Err(usage("--replan accepts 0 to 1000, --horizon 1 to 1000"));
    }
    Ok((replan > 0.0).then_some(Replanning { rate: replan, delay: path_delay, horizon }))
}

fn check_files(arguments: &Arguments) -> anyhow::Result<()> {
    let written = arguments.out.as_ref().map(|out| ["report.html", "figures.json"].map(|name| out.join(name)));
    let files = Files::default()
        .read_map("--world", Some(Path::new(&arguments.world)))
        .read("--path", arguments.path.as_deref())
        .read("--costs", arguments.costs.as_deref())
        .read("--config", arguments.configuration.file());
    let files = written.iter().flatten().fold(files, |files, path| files.written("a file of --out", Some(path)));
    files.check()
}
