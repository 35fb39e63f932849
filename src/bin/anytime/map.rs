//! `anytime map`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use anytime_scan_matcher::anytime::clock::Clock;
use anytime_scan_matcher::app::App;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::evaluation::trajectory::StampedPose;
use anytime_scan_matcher::geometry::Point;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::contract_schedule::ContractSchedule;
use anytime_scan_matcher::io::map_files::{MapFiles, MapPaths, append};
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::map::grid::OccupancyGrid;
use anytime_scan_matcher::mapping::{EdgeKind, Mapper, SelfHits};
use anytime_scan_matcher::odometry::{Failure, Outcome};
use anytime_scan_matcher::output::OutputFile;
use anytime_scan_matcher::replay::failures::Failures;
use anytime_scan_matcher::replay::map_picture::Picture;
use anytime_scan_matcher::replay::map_summary::{MapSummary, Stages};
use anytime_scan_matcher::replay::{Source, replay, survey};
use anytime_scan_matcher::scan::Sectors;
use clap::{Args, ValueEnum};

use crate::files::{Files, create};
use crate::input_flags::InputFlags;
use crate::progress;

/// Build a map from the scans of bags
#[derive(Args)]
pub(crate) struct Arguments {
    /// The bags, in the order of recording
    #[arg(required = true)]
    bags: Vec<PathBuf>,
    /// Prefix of the files to write: PREFIX.yaml and PREFIX.pgm (the map), PREFIX.png (a picture with the path), PREFIX.graph (to
    /// extend the map later)
    #[arg(long, value_name = "PREFIX")]
    out: PathBuf,
    /// Write the final pose of every scan to this file, after all corrections
    #[arg(long, value_name = "FINAL.tum")]
    tum: Option<PathBuf>,
    /// Size of a cell, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = resolution)]
    resolution: f64,
    /// Detect and ignore rays that hit the robot itself
    #[arg(long, value_enum, default_value = "auto")]
    mask_self: MaskSelf,
    /// Extend the map of this graph; the start pose of the robot on it may be unknown
    #[arg(long, value_name = "OLD.graph")]
    extend: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    input: InputFlags,
}

/// Maximum delay of odometry behind its scans that is used, slightly more than the lags that are estimated.
const ODOMETRY_AHEAD: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MaskSelf {
    /// Ignore rays whose ranges do not change while the robot moves: they hit the robot
    Auto,
    /// Use every ray accepted by `scan.*`
    Off,
}

fn resolution(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|side| (0.005..=1.0).contains(side)).ok_or_else(|| "expected 0.005 to 1 (metres)".into())
}

/// The files of a map.
struct Outputs {
    map: MapPaths,
    picture: PathBuf,
}

impl Outputs {
    fn new(prefix: &Path) -> Self {
        Self { map: MapPaths::new(prefix), picture: append(prefix, ".png") }
    }
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let mut config = arguments.input.configuration.load()?;
    let outputs = Outputs::new(&arguments.out);
    files(arguments, &config, &outputs).check()?;
    let mut files = OutputFiles::create(&outputs, arguments.tum.as_deref())?;
    let clock = arguments.input.clock.clock();
    let mut survey = Survey::of(arguments, &config, &clock)?;
    let detected = survey.self_hits.sectors();
    let masked_sectors = if arguments.mask_self == MaskSelf::Auto { Sectors(detected) } else { Sectors::default() };
    if !masked_sectors.0.is_empty() {
        config.scan.masked_sectors.0.extend_from_slice(&masked_sectors.0);
        let first = survey.stages;
        survey = Survey::of(arguments, &config, &clock)?;
        survey.stages.replay += first.replay + first.keyframes;
    }
    let Survey { mut mapper, mut stages, mut problems, .. } = survey;
    let start = clock.now();
    mapper.finish();
    let end = clock.now();
    let map = mapper.grid(arguments.resolution).to_map().context("no ray of the scans has a measurement: the map is empty")??;
    (stages.graph, stages.grid) = (end.saturating_sub(start), clock.now().saturating_sub(end));
    let path = mapper.trajectory();
    problems.extend(limitations(&mapper, &path));
    files.write(&mapper, &map, &path)?;
    let summary = MapSummary::new(&mapper, &path, &map, masked_sectors, stages, problems);
    let output_files = self::files(arguments, &config, &outputs);
    Ok(output_files.output(arguments.json, || summary.to_json(), || summary.to_text()))
}

/// The map and the statistics from all bags.
struct Survey {
    mapper: Mapper,
    self_hits: SelfHits,
    stages: Stages,
    /// Problems to report to the user.
    problems: Vec<String>,
}

impl Survey {
    /// Processes all bags.
    fn of(arguments: &Arguments, config: &Config, clock: &Arc<dyn Clock>) -> anyhow::Result<Self> {
        let mapper = match &arguments.extend {
            Some(path) => old_map(path, config)?,
            None => Mapper::new(&config.matching, &config.rejection),
        };
        let mut survey = Self { mapper, self_hits: SelfHits::default(), stages: Stages::default(), problems: Vec::new() };
        arguments.bags.iter().try_for_each(|bag| survey.add(arguments, bag, config, clock))?;
        Ok(survey)
    }

    /// Adds the scans of a bag to the mapper.
    fn add(&mut self, arguments: &Arguments, path: &Path, config: &Config, clock: &Arc<dyn Clock>) -> anyhow::Result<()> {
        let bag = Bag::open(path)?;
        let mut topics = arguments.input.topics(&bag, config)?;
        topics.odometry_ahead = ODOMETRY_AHEAD;
        let mut app = App::new(config, Arc::clone(clock))?;
        app.warm_up()?;
        let progress = progress::bar(bag.message_count(Some(&topics.all())))?;
        let schedule = ContractSchedule::default();
        let source = Source { bag: &bag, topics: &topics, schedule: &schedule };
        let (start, before) = (clock.now(), self.mapper.keyframes().len());
        let (mut mapping, mut scans, mut failures) = (Duration::ZERO, 0, Failures::default());
        let log = replay::<anyhow::Error>(
            &source,
            &mut app,
            &**clock,
            || progress.inc(1),
            |scan, estimate, app| {
                let begun = clock.now();
                scans += 1;
                if let Outcome::Predicted(Failure { reason, text }) = &estimate.registration.outcome {
                    failures.add(reason.name(), text);
                }
                survey::add_scan(&mut self.mapper, &mut self.self_hits, scan, estimate, app);
                mapping += clock.now().saturating_sub(begun);
                Ok(())
            },
        )?;
        progress.finish_and_clear();
        self.stages.keyframes += mapping;
        self.stages.replay += clock.now().saturating_sub(start).saturating_sub(mapping);
        let unusable = failures.unusable().descriptions(scans);
        if self.mapper.keyframes().len() == before {
            bail!("{}: no scan on {} could be used{}", path.display(), topics.scan, log.reasons(&bag, &unusable));
        }
        let assumed = app.mount().1.warning().map(Into::into);
        let counted = app.odometry_counters().in_words();
        self.problems.extend(bag.problems().iter().map(ToString::to_string));
        self.problems.extend(log.problems().chain(unusable).chain(assumed).chain(counted));
        Ok(())
    }
}

/// Reads the map of a graph file.
fn old_map(path: &Path, config: &Config) -> anyhow::Result<Mapper> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read the graph {}", path.display()))?;
    Mapper::from_bytes(&bytes, &config.matching, &config.rejection).with_context(|| format!("graph {}", path.display()))
}

/// Warnings about limitations of the map.
fn limitations(mapper: &Mapper, path: &[StampedPose]) -> Vec<String> {
    let not_moved = mapper.keyframes().len() == 1 && path.len() > 1;
    let not_moved = not_moved.then(|| "the robot has not moved: the map shows only what is visible from one pose".into());
    let unplaced = mapper.unplaced_runs();
    let unplaced = (unplaced > 0).then(|| {
        format!(
            "the start of {unplaced} runs could not be located on the map: they are not in the map, and their poses are those of their odometry \
             (a run starts with each bag and with each jump back in time; it must revisit places on the map over at least 5 m)"
        )
    });
    not_moved.into_iter().chain(unplaced).collect()
}

fn files<'a>(arguments: &'a Arguments, config: &'a Config, outputs: &'a Outputs) -> Files<'a> {
    let bags = arguments.bags.iter();
    bags.fold(Files::default(), |files, bag| files.read("the bag", Some(bag)))
        .with_flags(&arguments.input, config)
        .read("--extend", arguments.extend.as_deref().filter(|old| *old != outputs.map.graph))
        .written("--tum", arguments.tum.as_deref())
        .written("--out, the graph", Some(&outputs.map.graph))
        .written("--out, the map", Some(&outputs.map.yaml))
        .written("--out, its image", Some(&outputs.map.image))
        .written("--out, the picture", Some(&outputs.picture))
}

/// The files being written. They are created before the work, so that an unwritable folder is reported at once.
struct OutputFiles {
    map: MapFiles,
    picture: OutputFile,
    tum: Option<OutputFile>,
}

impl OutputFiles {
    fn create(outputs: &Outputs, tum: Option<&Path>) -> anyhow::Result<Self> {
        Ok(Self {
            map: MapFiles::create(outputs.map.clone())?,
            picture: create(&outputs.picture)?,
            tum: tum.map(create).transpose()?,
        })
    }

    fn write(&mut self, mapper: &Mapper, map: &OccupancyGrid, path: &[StampedPose]) -> anyhow::Result<()> {
        self.map.write(map, &mapper.to_bytes())?;
        let positions: Vec<Point> = path.iter().map(|stamped| stamped.pose.translation()).collect();
        let position = |keyframe: usize| mapper.graph().poses()[keyframe].translation();
        let loops = mapper.graph().edges().iter().filter(|edge| edge.kind == EdgeKind::Loop);
        let loops: Vec<(Point, Point)> = loops.map(|edge| (position(edge.from), position(edge.to))).collect();
        Picture { map, path: &positions, loops: &loops }.write_png(&mut self.picture).context("cannot write the picture")?;
        if let Some(tum) = &mut self.tum {
            let mut lines = TumWriter::new(Vec::new());
            path.iter().try_for_each(|pose| lines.write(pose))?;
            tum.write_all(&lines.into_sink()).context("cannot write the trajectory")?;
        }
        self.map.commit()?;
        let files = std::iter::once(&mut self.picture).chain(&mut self.tum);
        files.into_iter().try_for_each(OutputFile::commit).context("cannot move the files to their final names")
    }
}
