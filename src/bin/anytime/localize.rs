//! `anytime localize`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use anytime_scan_matcher::app::localizer::Localizer;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::evaluation::association::associate;
use anytime_scan_matcher::evaluation::report::Comparison;
use anytime_scan_matcher::evaluation::trajectory::{StampedPose, Trajectory};
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::csv_file::CsvFile;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::knobs::{KnobValue, Value};
use anytime_scan_matcher::output::OutputFile;
use anytime_scan_matcher::replay::localize::{Answer, LocalizationSummary, localize};
use anytime_scan_matcher::replay::row::BeliefRow;
use anytime_scan_matcher::replay::truth;
use clap::Args;

use crate::input_flags::{Files, InputFlags};
use crate::knob_flags::value;
use crate::outcome::{shown, usage};
use crate::progress;

/// Localize the robot of a bag on a map with a particle filter
#[derive(Args)]
pub(crate) struct Arguments {
    bag: PathBuf,
    /// The map: a YAML file of `map_server` [default: `localization.map`]
    #[arg(long, value_name = "M.yaml")]
    map: Option<PathBuf>,
    /// Number of particles [default: `localization.particles`]
    #[arg(long)]
    particles: Option<u32>,
    /// The initial pose is unknown: global localization
    #[arg(long, conflicts_with = "initial_pose")]
    global: bool,
    /// Where the robot starts, m and rad [default: `localization.initial_pose`; else the first true pose; else the origin of the map]
    #[arg(long, value_name = "X,Y,YAW", value_parser = pose, allow_hyphen_values = true)]
    initial_pose: Option<Pose2>,
    /// Time from a scan's arrival to its pose, such as 5ms; without a unit, seconds [default: `contract.time_budget`]
    #[arg(long, value_parser = value, allow_hyphen_values = true)]
    time_budget: Option<Value>,
    /// Write the pose of every scan; `anytime profile` takes it for a truth
    #[arg(long, value_name = "OUT.tum")]
    tum: Option<PathBuf>,
    /// Write a row of CSV for every scan
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    input: InputFlags,
}

fn pose(text: &str) -> Result<Pose2, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(pose @ &[x, y, yaw]) if pose.iter().all(|number| number.is_finite()) => Pose2::from_value(&vec![x, y, yaw].into()),
        _ => Err("expected x,y,yaw in metres and radians, such as 1.5,-2,3.14".into()),
    }
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let mut config = configuration(arguments)?;
    let map = arguments.map.clone().or(config.localization.map.as_ref().map(PathBuf::from));
    let map = map.ok_or_else(|| usage("there is no map: --map M.yaml, or the parameter localization.map"))?;
    files(arguments, &config).check()?;
    arguments.input.clock.prepare(&mut config);
    let clock = arguments.input.clock.clock();
    let bag = Bag::open(&arguments.bag)?;
    let topics = arguments.input.topics(&bag, &config)?;
    let truth = arguments.input.truth.as_deref().map(|name| truth::load(name, &bag)).transpose()?;
    let mut localizer = Localizer::new(map_file::read(&map)?, &config, Arc::clone(&clock))?;
    localizer.warm_up();
    if arguments.global {
        localizer.spread();
    } else {
        let by_flag = arguments.initial_pose.map(|pose| ("--initial-pose", pose));
        let told = by_flag.or(config.localization.initial_pose.map(|pose| ("localization.initial_pose", pose)));
        if let Some((name, pose)) = &told {
            localizer.check_place(pose).map_err(|error| usage(format!("{name}: {error}")))?;
        }
        let first_truth = truth.as_ref().map(|truth| truth.ends().0.pose);
        localizer.start_at(&told.map(|(_, pose)| pose).or(first_truth).unwrap_or_default(), None);
    }
    let mut records = Records::create(arguments, &config.frames.map_frame)?;
    let progress = progress::bar(bag.message_count(Some(&topics.all())))?;
    let tick = || progress.inc(1);
    let log = localize::<anyhow::Error>(&bag, &topics, &mut localizer, &*clock, tick, |answer, _| records.add(answer))?;
    progress.finish_and_clear();
    if records.summary.poses().is_empty() {
        let why = log.reasons(&bag, &records.summary.unused());
        bail!("{}: no scan on {} could be used{why}", arguments.bag.display(), topics.scan);
    }
    let summary = records.finish()?;
    let localized = Some(summary.localized()).filter(|poses| !poses.is_empty());
    let trajectory = localized.map(|poses| Trajectory::new(poses.to_vec())).transpose()?;
    let matched = trajectory.zip(truth).map(|(trajectory, truth)| associate(&trajectory, &truth, Comparison::default().max_dt));
    let matched = matched.transpose()?;
    let errors = matched.and_then(|matched| summary.errors(&matched));
    let mut problems: Vec<String> = bag.problems().iter().map(ToString::to_string).chain(log.problems()).collect();
    problems.extend(localizer.mount().1.reservation().map(Into::into));
    problems.extend(localizer.events_in_words().chain(summary.lost()));
    let text = files(arguments, &config).shown(
        arguments.json,
        || summary.to_json(errors.as_ref(), &problems),
        || summary.to_text(errors.as_ref(), &problems),
    );
    shown(text, summary.failure())
}

/// The parameters, with what the flags set.
fn configuration(arguments: &Arguments) -> anyhow::Result<Config> {
    let mut config = arguments.input.configuration.load()?;
    if let Some(particles) = arguments.particles {
        config.set("localization.particles", &particles.into(), "--particles")?;
    }
    if let Some(budget) = &arguments.time_budget {
        config.set("contract.time_budget", budget, "--time-budget")?;
    }
    Ok(config)
}

/// The summary, and the files asked for.
struct Records {
    map_frame: String,
    tum: Option<TumWriter<OutputFile>>,
    csv: Option<CsvFile<OutputFile, BeliefRow>>,
    summary: LocalizationSummary,
}

impl Records {
    fn create(arguments: &Arguments, map_frame: &str) -> anyhow::Result<Self> {
        let tum = arguments.tum.as_deref().map(create).transpose()?.map(TumWriter::new);
        let csv = arguments.csv.as_deref().map(create).transpose()?;
        let csv = csv.map(|file| CsvFile::new(file, BeliefRow::COLUMNS)).transpose()?;
        Ok(Self { map_frame: map_frame.into(), tum, csv, summary: LocalizationSummary::default() })
    }

    fn add(&mut self, answer: &Answer) -> anyhow::Result<()> {
        let pose = match answer {
            Answer::Fix(fix) => {
                let row = BeliefRow::new(fix, &self.map_frame);
                // A scan that could not be used has no row.
                if let (Some(csv), Some(_)) = (&mut self.csv, row.pose) {
                    csv.write(&row).context("cannot write the CSV file")?;
                }
                self.summary.add(&row)
            }
            &Answer::Between { stamp, map_from_base } => {
                self.summary.pass_over();
                Some(StampedPose { stamp, pose: map_from_base })
            }
        };
        if let (Some(pose), Some(tum)) = (pose, &mut self.tum) {
            tum.write(&pose).context("cannot write the trajectory")?;
        }
        Ok(())
    }

    /// Puts the files in their places.
    fn finish(self) -> anyhow::Result<LocalizationSummary> {
        if let Some(tum) = self.tum {
            tum.into_sink().commit().context("cannot write the trajectory")?;
        }
        if let Some(csv) = self.csv {
            csv.into_sink().and_then(|mut file| file.commit()).context("cannot write the CSV file")?;
        }
        Ok(self.summary)
    }
}

fn files<'a>(arguments: &'a Arguments, config: &'a Config) -> Files<'a> {
    Files::default()
        .of(&arguments.input, config)
        .read("the bag", Some(&arguments.bag))
        .read("contract.cost_file", config.contract.cost_file.as_deref().map(Path::new))
        .read_map("--map", arguments.map.as_deref())
        .written("--tum", arguments.tum.as_deref())
        .written("--csv", arguments.csv.as_deref())
}

fn create(path: &Path) -> anyhow::Result<OutputFile> {
    OutputFile::create(path).with_context(|| format!("cannot create {}", path.display()))
}
