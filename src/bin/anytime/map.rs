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
use anytime_scan_matcher::io::map_files::{MapFiles, MapPaths, ending};
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

use crate::input_flags::{Files, InputFlags};
use crate::progress;

/// Make a map from the scans of bags
#[derive(Args)]
pub(crate) struct Arguments {
    /// Bags, in the order they were recorded
    #[arg(required = true)]
    bags: Vec<PathBuf>,
    /// Writes PREFIX.yaml and PREFIX.pgm (the map), PREFIX.png (a picture with the path), PREFIX.graph (to extend it later)
    #[arg(long, value_name = "PREFIX")]
    out: PathBuf,
    /// Write the final pose of every scan, after all corrections
    #[arg(long, value_name = "FINAL.tum")]
    tum: Option<PathBuf>,
    /// Side of a cell, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = resolution)]
    resolution: f64,
    /// Whether to detect rays that hit the robot itself, and leave them out
    #[arg(long, value_enum, default_value = "auto")]
    mask_self: MaskSelf,
    /// Extend the map of this graph; the robot may start anywhere on it
    #[arg(long, value_name = "OLD.graph")]
    extend: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    input: InputFlags,
}

/// Odometry that comes so much later than the scans it belongs to is used all the same: a little more than the lags looked for.
const ODOMETRY_AHEAD: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MaskSelf {
    /// Rays that do not change while the robot moves hit the robot: they are left out
    Auto,
    /// Use every ray that `scan.*` accepts
    Off,
}

fn resolution(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|side| (0.005..=1.0).contains(side)).ok_or_else(|| "expected metres, 0.005 to 1".into())
}

/// The files that a map is made of.
struct Outputs {
    map: MapPaths,
    picture: PathBuf,
}

impl Outputs {
    fn new(prefix: &Path) -> Self {
        Self { map: MapPaths::new(prefix), picture: ending(prefix, ".png") }
    }
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let mut config = arguments.input.configuration.load()?;
    let outputs = Outputs::new(&arguments.out);
    files(arguments, &config, &outputs).check()?;
    let mut files = OutputFiles::create(&outputs, arguments.tum.as_deref())?;
    let clock = arguments.input.clock.clock();
    let mut survey = Survey::of(arguments, &config, &clock)?;
    let own = survey.self_hits.found();
    let found = if arguments.mask_self == MaskSelf::Auto { Sectors(own) } else { Sectors::default() };
    if !found.0.is_empty() {
        config.scan.masked_sectors.0.extend_from_slice(&found.0);
        let first = survey.stages;
        survey = Survey::of(arguments, &config, &clock)?;
        survey.stages.replay += first.replay + first.keyframes;
    }
    let Survey { mut mapper, mut stages, mut problems, .. } = survey;
    let start = clock.now();
    mapper.finish();
    let drawn = clock.now();
    let map =
        mapper.grid(arguments.resolution).to_map().context("no ray of the scans has an end: there is nothing to draw")??;
    (stages.graph, stages.grid) = (drawn.saturating_sub(start), clock.now().saturating_sub(drawn));
    let path = mapper.trajectory();
    problems.extend(reservations(&mapper, &path));
    files.write(&mapper, &map, &path)?;
    let summary = MapSummary::new(&mapper, &path, &map, found, stages, problems);
    let roles = self::files(arguments, &config, &outputs);
    Ok(roles.shown(arguments.json, || summary.to_json(), || summary.to_text()))
}

/// What the bags have come to.
struct Survey {
    mapper: Mapper,
    self_hits: SelfHits,
    stages: Stages,
    /// What the user should know.
    problems: Vec<String>,
}

impl Survey {
    /// Of all bags.
    fn of(arguments: &Arguments, config: &Config, clock: &Arc<dyn Clock>) -> anyhow::Result<Self> {
        let mapper = match &arguments.extend {
            Some(path) => old_map(path, config)?,
            None => Mapper::new(&config.matching, &config.rejection),
        };
        let mut survey = Self { mapper, self_hits: SelfHits::default(), stages: Stages::default(), problems: Vec::new() };
        arguments.bags.iter().try_for_each(|bag| survey.add(arguments, bag, config, clock))?;
        Ok(survey)
    }

    /// Hands the scans of a bag to the mapper.
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
                survey::hand_over(&mut self.mapper, &mut self.self_hits, scan, estimate, app);
                mapping += clock.now().saturating_sub(begun);
                Ok(())
            },
        )?;
        progress.finish_and_clear();
        self.stages.keyframes += mapping;
        self.stages.replay += clock.now().saturating_sub(start).saturating_sub(mapping);
        let unusable = failures.unusable().in_words(scans);
        if self.mapper.keyframes().len() == before {
            bail!("{}: no scan on {} could be used{}", path.display(), topics.scan, log.reasons(&bag, &unusable));
        }
        let assumed = app.mount().1.reservation().map(Into::into);
        let counted = app.odometry_counters().in_words();
        self.problems.extend(bag.problems().iter().map(ToString::to_string));
        self.problems.extend(log.problems().chain(unusable).chain(assumed).chain(counted));
        Ok(())
    }
}

/// The map of a graph file.
fn old_map(path: &Path, config: &Config) -> anyhow::Result<Mapper> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read the graph {}", path.display()))?;
    Mapper::from_bytes(&bytes, &config.matching, &config.rejection).with_context(|| format!("graph {}", path.display()))
}

/// What makes the map less than it may seem.
fn reservations(mapper: &Mapper, path: &[StampedPose]) -> Vec<String> {
    let still = mapper.keyframes().len() == 1 && path.len() > 1;
    let still = still.then(|| "the robot has not moved: the map is what is seen from one place".into());
    let unplaced = mapper.unplaced_runs();
    let unplaced = (unplaced > 0).then(|| {
        format!(
            "where {unplaced} of the runs began on the map could not be found: they are not drawn, and their poses are those of their odometry \
             (a run begins with a bag, and where time goes back; it must pass places seen before, for 5 m at least)"
        )
    });
    still.into_iter().chain(unplaced).collect()
}

fn files<'a>(arguments: &'a Arguments, config: &'a Config, outputs: &'a Outputs) -> Files<'a> {
    let bags = arguments.bags.iter();
    bags.fold(Files::default(), |files, bag| files.read("the bag", Some(bag)))
        .of(&arguments.input, config)
        .read("--extend", arguments.extend.as_deref().filter(|old| *old != outputs.map.graph))
        .written("--tum", arguments.tum.as_deref())
        .written("--out, the graph", Some(&outputs.map.graph))
        .written("--out, the map", Some(&outputs.map.yaml))
        .written("--out, its image", Some(&outputs.map.image))
        .written("--out, the picture", Some(&outputs.picture))
}

/// The files being written: begun before the work, so that a folder that cannot be written to is told at once.
struct OutputFiles {
    map: MapFiles,
    picture: OutputFile,
    tum: Option<OutputFile>,
}

impl OutputFiles {
    fn create(outputs: &Outputs, tum: Option<&Path>) -> anyhow::Result<Self> {
        let create = |path: &Path| OutputFile::create(path).with_context(|| format!("cannot create {}", path.display()));
        Ok(Self {
            map: MapFiles::create(outputs.map.clone())?,
            picture: create(&outputs.picture)?,
            tum: tum.map(create).transpose()?,
        })
    }

    fn write(&mut self, mapper: &Mapper, map: &OccupancyGrid, path: &[StampedPose]) -> anyhow::Result<()> {
        self.map.write(map, &mapper.to_bytes())?;
        let places: Vec<Point> = path.iter().map(|stamped| stamped.pose.translation()).collect();
        let place = |keyframe: usize| mapper.graph().poses()[keyframe].translation();
        let loops = mapper.graph().edges().iter().filter(|edge| edge.kind == EdgeKind::Loop);
        let loops: Vec<(Point, Point)> = loops.map(|edge| (place(edge.from), place(edge.to))).collect();
        Picture { map, path: &places, loops: &loops }.write_png(&mut self.picture).context("cannot write the picture")?;
        if let Some(tum) = &mut self.tum {
            let mut lines = TumWriter::new(Vec::new());
            path.iter().try_for_each(|pose| lines.write(pose))?;
            tum.write_all(&lines.into_sink()).context("cannot write the trajectory")?;
        }
        self.map.commit()?;
        let files = std::iter::once(&mut self.picture).chain(&mut self.tum);
        files.into_iter().try_for_each(OutputFile::commit).context("cannot put the files in their places")
    }
}
