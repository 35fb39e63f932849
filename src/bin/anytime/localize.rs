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
use anytime_scan_matcher::replay::localize::{LocalizationSummary, ScanOutcome, localize};
use anytime_scan_matcher::replay::row::BeliefRow;
use anytime_scan_matcher::replay::truth;
use clap::Args;

use crate::files::{Files, create};
use crate::input_flags::InputFlags;
use crate::knob_flags::value;
use crate::outcome::{output_or_failure, usage};
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
    /// Localize globally: the initial pose is unknown
    #[arg(long, conflicts_with = "initial_pose")]
    global: bool,
    /// Initial pose, m and rad [default: `localization.initial_pose`; else the first true pose; else the origin of the map]
    #[arg(long, value_name = "X,Y,YAW", value_parser = pose, allow_hyphen_values = true)]
    initial_pose: Option<Pose2>,
    /// Time budget from a scan's arrival to its pose, such as 5ms; in seconds without a unit [default: `contract.time_budget`]
    #[arg(long, value_parser = value, allow_hyphen_values = true)]
    time_budget: Option<Value>,
    /// Write the pose of every scan to this file; `anytime profile` accepts it as ground truth
    #[arg(long, value_name = "OUT.tum")]
    tum: Option<PathBuf>,
    /// Write one CSV row per scan to this file
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
    let map = map.ok_or_else(|| usage("no map is given: use --map M.yaml or the parameter localization.map"))?;
    files(arguments, &config).check()?;
    arguments.input.clock.prepare(&mut config);
    let clock = arguments.input.clock.clock();
    let bag = Bag::open(&arguments.bag)?;
    let topics = arguments.input.topics(&bag, &config)?;
    let truth = arguments.input.truth.as_deref().map(|name| truth::load(name, &bag)).transpose()?;
    let mut localizer = Localizer::new(map_file::read(&map)?, &config, Arc::clone(&clock))?;
    localizer.warm_up();
    if arguments.global {
        localizer.start_globally();
    } else {
        let by_flag = arguments.initial_pose.map(|pose| ("--initial-pose", pose));
        let given = by_flag.or(config.localization.initial_pose.map(|pose| ("localization.initial_pose", pose)));
        if let Some((name, pose)) = &given {
            localizer.check_on_map(pose).map_err(|error| usage(format!("{name}: {error}")))?;
        }
        let first_truth = truth.as_ref().map(|truth| truth.ends().0.pose);
        localizer.start_at(&given.map(|(_, pose)| pose).or(first_truth).unwrap_or_default(), None);
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
    problems.extend(localizer.mount().1.warning().map(Into::into));
    problems.extend(localizer.events_in_words().chain(summary.lost()));
    let text = files(arguments, &config).output(
        arguments.json,
        || summary.to_json(errors.as_ref(), &problems),
        || summary.to_text(errors.as_ref(), &problems),
    );
    output_or_failure(text, summary.failure())
}

/// The parameters, with those set by flags.
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

/// The summary and the requested output files.
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

    fn add(&mut self, answer: &ScanOutcome) -> anyhow::Result<()> {
        let pose = match answer {
            ScanOutcome::Fix(fix) => {
                let row = BeliefRow::new(fix, &self.map_frame);
                // A scan that was not used has no row.
                if let (Some(csv), Some(_)) = (&mut self.csv, row.pose) {
                    csv.write(&row).context("cannot write the CSV file")?;
                }
                self.summary.add(&row)
            }
            &ScanOutcome::Skipped { stamp, map_from_base } => {
                self.summary.add_skipped();
                Some(StampedPose { stamp, pose: map_from_base })
            }
        };
        if let (Some(pose), Some(tum)) = (pose, &mut self.tum) {
            tum.write(&pose).context("cannot write the trajectory")?;
        }
        Ok(())
    }

    /// Completes the files.
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
        .with_flags(&arguments.input, config)
        .read("the bag", Some(&arguments.bag))
        .read("contract.cost_file", config.contract.cost_file.as_deref().map(Path::new))
        .read_map("--map", arguments.map.as_deref())
        .written("--tum", arguments.tum.as_deref())
        .written("--csv", arguments.csv.as_deref())
}
