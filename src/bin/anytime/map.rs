//! `anytime map`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use anytime_scan_matcher::anytime::clock::Clock;
use anytime_scan_matcher::app::{App, MountSource};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::evaluation::trajectory::StampedPose;
use anytime_scan_matcher::geometry::Point;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::contract_schedule::ContractSchedule;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::map::grid::OccupancyGrid;
use anytime_scan_matcher::mapping::{EdgeKind, Mapper};
use anytime_scan_matcher::output::OutputFile;
use anytime_scan_matcher::replay::map_picture::Picture;
use anytime_scan_matcher::replay::map_summary::{MapSummary, Stages};
use anytime_scan_matcher::replay::{Source, replay, survey};
use clap::Args;

use crate::input_flags::{Files, InputFlags};
use crate::progress;

/// Make a map of what the laser of a bag has seen
#[derive(Args)]
pub(crate) struct Arguments {
    /// Bags, in the order they were recorded
    #[arg(required = true)]
    bags: Vec<PathBuf>,
    /// Writes PREFIX.yaml and PREFIX.pgm (the map), PREFIX.png (a picture of it with the path)
    #[arg(long, value_name = "PREFIX")]
    out: PathBuf,
    /// Write the final pose of every scan, after all corrections
    #[arg(long, value_name = "FINAL.tum")]
    tum: Option<PathBuf>,
    /// Side of a cell, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = resolution)]
    resolution: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    input: InputFlags,
}

fn resolution(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|side| (0.005..=1.0).contains(side)).ok_or_else(|| "expected metres, 0.005 to 1".into())
}

/// The files that a map is made of.
struct Outputs {
    yaml: PathBuf,
    image: PathBuf,
    picture: PathBuf,
}

impl Outputs {
    fn new(prefix: &Path) -> Self {
        let named = |ending: &str| {
            let mut name = prefix.as_os_str().to_owned();
            name.push(ending);
            PathBuf::from(name)
        };
        Self { yaml: named(".yaml"), image: named(".pgm"), picture: named(".png") }
    }
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let config = arguments.input.configuration.load()?;
    let outputs = Outputs::new(&arguments.out);
    files(arguments, &config, &outputs).check()?;
    let mut files = MapFiles::create(&outputs, arguments.tum.as_deref())?;
    let clock = arguments.input.clock.clock();
    let mut mapper = Mapper::new(&config.matching, &config.rejection);
    let mut stages = Stages::default();
    let mut problems = Vec::new();
    for bag in &arguments.bags {
        problems.extend(survey_bag(arguments, bag, &config, &clock, &mut mapper, &mut stages)?);
    }
    let start = clock.now();
    mapper.finish();
    let drawn = clock.now();
    let map =
        mapper.grid(arguments.resolution).to_map().context("no ray of the scans has an end: there is nothing to draw")??;
    (stages.graph, stages.grid) = (drawn.saturating_sub(start), clock.now().saturating_sub(drawn));
    let path = mapper.trajectory();
    problems.extend(reservations(&mapper, &path));
    files.write(&mapper, &map, &path, &outputs.image)?;
    let summary = MapSummary::new(&mapper, &path, &map, stages, problems);
    Ok(if arguments.json { summary.to_json().to_string() } else { summary.to_text() })
}

/// Hands the scans of a bag to the mapper; answers what the user should know.
fn survey_bag(
    arguments: &Arguments,
    path: &Path,
    config: &Config,
    clock: &Arc<dyn Clock>,
    mapper: &mut Mapper,
    stages: &mut Stages,
) -> anyhow::Result<Vec<String>> {
    let bag = Bag::open(path)?;
    let topics = arguments.input.topics(&bag)?;
    let mut app = App::new(config, Arc::clone(clock))?;
    app.warm_up()?;
    let progress = progress::bar(bag.message_count(Some(&topics.all())))?;
    let schedule = ContractSchedule::default();
    let source = Source { bag: &bag, topics: &topics, schedule: &schedule };
    let (start, before) = (clock.now(), mapper.keyframes().len());
    let mut mapping = Duration::ZERO;
    let log = replay::<anyhow::Error>(
        &source,
        &mut app,
        &**clock,
        || progress.inc(1),
        |scan, estimate, app| {
            let begun = clock.now();
            survey::hand_over(mapper, scan, estimate, app);
            mapping += clock.now().saturating_sub(begun);
            Ok(())
        },
    )?;
    progress.finish_and_clear();
    stages.keyframes += mapping;
    stages.replay += clock.now().saturating_sub(start).saturating_sub(mapping);
    if mapper.keyframes().len() == before {
        bail!("{}: no scan on {} could be used{}", path.display(), topics.scan, log.reasons(&bag));
    }
    let assumed = (app.mount().1 == MountSource::Assumed).then(|| {
        "where the laser is on the base is not known: taken to be at its origin (set odometry.laser_in_base, or record /tf_static)".into()
    });
    Ok(bag.problems().iter().map(ToString::to_string).chain(log.problems).chain(assumed).collect())
}

/// What makes the map less than it may seem.
fn reservations(mapper: &Mapper, path: &[StampedPose]) -> Vec<String> {
    let still = mapper.keyframes().len() == 1 && path.len() > 1;
    still.then(|| "the robot has not moved: the map is what is seen from one place".into()).into_iter().collect()
}

fn files<'a>(arguments: &'a Arguments, config: &'a Config, outputs: &'a Outputs) -> Files<'a> {
    let bags = arguments.bags.iter();
    bags.fold(Files::default(), |files, bag| files.read("the bag", Some(bag)))
        .of(&arguments.input, config)
        .written("--tum", arguments.tum.as_deref())
        .written("--out, the map", Some(&outputs.yaml))
        .written("--out, its image", Some(&outputs.image))
        .written("--out, the picture", Some(&outputs.picture))
}

/// The files being written: begun before the work, so that a folder that cannot be written to is told at once.
struct MapFiles {
    yaml: OutputFile,
    image: OutputFile,
    picture: OutputFile,
    tum: Option<OutputFile>,
}

impl MapFiles {
    fn create(outputs: &Outputs, tum: Option<&Path>) -> anyhow::Result<Self> {
        let create = |path: &Path| OutputFile::create(path).with_context(|| format!("cannot create {}", path.display()));
        Ok(Self {
            yaml: create(&outputs.yaml)?,
            image: create(&outputs.image)?,
            picture: create(&outputs.picture)?,
            tum: tum.map(create).transpose()?,
        })
    }

    fn write(&mut self, mapper: &Mapper, map: &OccupancyGrid, path: &[StampedPose], image_path: &Path) -> anyhow::Result<()> {
        map_file::write(map, image_path, &mut self.yaml, &mut self.image).context("cannot write the map")?;
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
        let files = [&mut self.image, &mut self.yaml, &mut self.picture].into_iter().chain(&mut self.tum);
        files.into_iter().try_for_each(OutputFile::commit).context("cannot put the files in their places")
    }
}
