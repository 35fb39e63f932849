//! `anytime replay`.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock, VirtualClock};
use anytime_scan_matcher::app::App;
use anytime_scan_matcher::evaluation::plot::trajectory_plot;
use anytime_scan_matcher::evaluation::report::{Comparison, Report};
use anytime_scan_matcher::evaluation::trajectory::Trajectory;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::replay::csv_file::CsvFile;
use anytime_scan_matcher::replay::map_sketch::MapSketch;
use anytime_scan_matcher::replay::summary::{Ending, Summary};
use anytime_scan_matcher::replay::{Topics, replay, truth};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use crate::configuration::Configuration;

/// Time that passes on the virtual clock at each reading.
const VIRTUAL_TICK: Duration = Duration::from_micros(10);

/// Match every scan of a bag, through the very code the node runs
#[derive(Args)]
pub(crate) struct Arguments {
    bag: PathBuf,
    /// Topic of the laser scans
    #[arg(long, default_value = "/scan")]
    scan_topic: String,
    /// Topic of the wheel odometry [default: /odom, if the bag has it]
    #[arg(long)]
    odom_topic: Option<String>,
    /// True poses to compare with: a TUM file, or a topic of the bag
    #[arg(long, value_name = "FILE|TOPIC")]
    truth: Option<String>,
    /// Time that a scan's answer may take, such as 5ms [default: no limit]
    #[arg(long, value_parser = humantime::parse_duration)]
    time_budget: Option<Duration>,
    /// The clock of the contract; with `virtual` all files of two runs are equal to the byte
    #[arg(long, value_enum, default_value = "monotonic")]
    clock: ClockChoice,
    /// Write the pose of every scan
    #[arg(long, value_name = "OUT.tum")]
    tum: Option<PathBuf>,
    /// Write a line of figures for every scan
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Draw the trajectory, the scans and the truth
    #[arg(long, value_name = "OUT.svg")]
    plot: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    configuration: Configuration,
}

#[derive(Clone, Copy, ValueEnum)]
enum ClockChoice {
    Monotonic,
    Virtual,
}

impl ClockChoice {
    fn clock(self) -> Arc<dyn Clock> {
        match self {
            Self::Monotonic => Arc::new(MonotonicClock::default()),
            Self::Virtual => Arc::new(VirtualClock::new(VIRTUAL_TICK)),
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let mut config = arguments.configuration.load()?;
    if let Some(budget) = arguments.time_budget {
        config.contract.time_budget = Seconds(budget.as_secs_f64());
    }
    let bag = Bag::open(&arguments.bag)?;
    let topics = Topics::resolve(&bag, &arguments.scan_topic, arguments.odom_topic.as_deref())?;
    let truth = arguments.truth.as_deref().map(|name| truth::load(name, &bag)).transpose()?;
    let clock = arguments.clock.clock();
    let mut app = App::new(&config, Arc::clone(&clock))?;
    let mut tum = arguments.tum.as_deref().map(|path| create(path).map(TumWriter::new)).transpose()?;
    let mut csv = arguments.csv.as_deref().map(|path| Ok::<_, anyhow::Error>(CsvFile::new(create(path)?)?)).transpose()?;
    let mut sketch = arguments.plot.is_some().then(MapSketch::default);
    let mut summary = Summary::default();
    let progress = progress_bar(bag.message_count(Some(&topics.all())));
    let log = replay(
        &bag,
        &topics,
        &mut app,
        &*clock,
        || progress.inc(1),
        |scan, estimate, app| {
            summary.add(estimate);
            if let (Some(tum), Some(pose)) = (&mut tum, summary.poses().last()) {
                tum.write(pose).context("writing the trajectory")?;
            }
            if let Some(csv) = &mut csv {
                csv.write(estimate).context("writing the CSV file")?;
            }
            if let Some(sketch) = &mut sketch {
                sketch.add(scan, estimate, app);
            }
            Ok::<_, anyhow::Error>(())
        },
    )?;
    progress.finish_and_clear();
    anyhow::ensure!(!summary.poses().is_empty(), "{}: no scan on {} could be read", arguments.bag.display(), topics.scan);
    let trajectory = Trajectory::new(summary.poses().to_vec())?;
    let report = truth.as_ref().map(|truth| Report::new(&trajectory, Some(truth), None, Comparison::default())).transpose()?;
    if let (Some(path), Some(sketch)) = (&arguments.plot, &sketch) {
        trajectory_plot(path, &trajectory, truth.as_ref(), Some(sketch.points()), Comparison::default().max_dt)?;
    }
    let ending = Ending {
        log,
        counters: *app.odometry_counters(),
        mount_source: app.mount().1,
        report,
        bag_problems: bag.problems().iter().map(ToString::to_string).collect(),
    };
    if arguments.json {
        println!("{}", summary.to_json(&ending));
    } else {
        print!("{}", summary.to_text(&ending));
    }
    Ok(())
}

fn create(path: &std::path::Path) -> anyhow::Result<File> {
    File::create(path).with_context(|| format!("cannot write {}", path.display()))
}

fn progress_bar(messages: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {percent}% {pos}/{len} messages, {eta} left");
    ProgressBar::new(messages).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
