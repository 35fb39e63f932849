//! `anytime evaluate`.

use std::path::{Path, PathBuf};

use anytime_scan_matcher::evaluation::map_comparison::MapComparison;
use anytime_scan_matcher::evaluation::plot::trajectory_plot;
use anytime_scan_matcher::evaluation::relations::RelationErrors;
use anytime_scan_matcher::evaluation::report::{Comparison, Report};
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::{map_file, relations, simulated_bag, tum};
use clap::Args;

use crate::files::{Files, svg_path};
use crate::outcome::output_or_failure;
use crate::terminal;

/// Compare a trajectory with the ground truth (ATE, RPE, relations), or a map with the true one
#[derive(Args)]
pub(crate) struct Arguments {
    /// The trajectory: lines of `timestamp x y z qx qy qz qw` (TUM) or `timestamp x y theta`
    #[arg(required_unless_present = "map", requires = "reference")]
    trajectory: Option<PathBuf>,
    /// Evaluate a map instead of a trajectory: a YAML file of `map_server`
    #[arg(long, value_name = "A.yaml", requires = "truth_map", conflicts_with_all = ["trajectory", "reference", "plot"])]
    map: Option<PathBuf>,
    /// The true map
    #[arg(long, value_name = "B.yaml", requires = "map")]
    truth_map: Option<PathBuf>,
    /// Align the map with the true one first; its offset may be up to 2 m and a few degrees
    #[arg(long, requires = "map")]
    align: bool,
    /// Count as missed only walls that the rays of this simulated drive (a bag of anytime simulate) hit; without it, every true
    /// wall next to free space of the map
    #[arg(long, value_name = "X.bag", requires = "map")]
    drive: Option<PathBuf>,
    #[command(flatten)]
    reference: Reference,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Plot the trajectory (with the truth and the errors) to this SVG file
    #[arg(long, value_name = "OUT.svg", value_parser = svg_path)]
    plot: Option<PathBuf>,
    /// Path length over which RPE measures drift, m
    #[arg(long, value_name = "M", default_value_t = Comparison::default().rpe_distance, value_parser = positive)]
    rpe_distance: f64,
    /// Maximum time difference of two poses that are compared, s
    #[arg(long, value_name = "S", default_value_t = Comparison::default().max_dt, value_parser = positive)]
    max_dt: f64,
}

#[derive(Args)]
#[group(id = "reference", multiple = true)]
struct Reference {
    /// The true trajectory, in the same format
    #[arg(long, value_name = "X.tum")]
    truth: Option<PathBuf>,
    /// True relative motions: lines of `t1 t2 x y z roll pitch yaw` (Kuemmerle et al. 2009)
    #[arg(long, value_name = "X.relations")]
    relations: Option<PathBuf>,
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(|| "expected a number above 0".into())
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    match arguments {
        Arguments { map: Some(map), truth_map: Some(truth), .. } => compare_maps(map, truth, arguments),
        Arguments { trajectory: Some(trajectory), .. } => compare_trajectory(trajectory, arguments),
        _ => Err(crate::outcome::usage("nothing to evaluate: a trajectory, or --map with --truth-map")),
    }
}

fn compare_maps(map: &Path, truth: &Path, arguments: &Arguments) -> anyhow::Result<String> {
    let Arguments { align, drive, json, .. } = arguments;
    let files =
        Files::default().read_map("--map", Some(map)).read_map("--truth-map", Some(truth)).read("--drive", drive.as_deref());
    let world = map_file::read(truth)?;
    let met = drive.as_deref().map(|drive| -> anyhow::Result<_> { Ok(simulated_bag::cells_hit(&Bag::open(drive)?, &world)?) });
    let comparison = MapComparison::new(&map_file::read(map)?, &world, *align, met.transpose()?.as_deref());
    let problem = comparison.to_truth.is_none().then(|| {
        let (map, truth) = (map.display(), truth.display());
        format!("{map} or {truth} has no occupied cell: there is nothing to compare")
    });
    output_or_failure(files.output(*json, || comparison.to_json(), || comparison.to_string()), problem)
}

fn compare_trajectory(trajectory: &Path, arguments: &Arguments) -> anyhow::Result<String> {
    let Arguments { reference, json, plot, rpe_distance, max_dt, .. } = arguments;
    let files = Files::default()
        .read("the trajectory", Some(trajectory))
        .read("--truth", reference.truth.as_deref())
        .read("--relations", reference.relations.as_deref())
        .written("--plot", plot.as_deref());
    files.check()?;
    let estimate = tum::read(trajectory)?;
    let truth = reference.truth.as_deref().map(tum::read).transpose()?;
    let relations = reference.relations.as_deref().map(relations::read).transpose()?;
    let comparison = Comparison { max_dt: *max_dt, rpe_distance: *rpe_distance };
    let report = Report::new(&estimate, truth.as_ref(), relations.as_deref(), comparison)?;
    if let Some(path) = plot {
        trajectory_plot(path, &estimate, truth.as_ref(), None, *max_dt)?;
    }
    let all_beyond = report.relations.as_ref().is_some_and(RelationErrors::all_beyond_max_dt);
    let problem = all_beyond.then(|| {
        let path = reference.relations.as_deref().unwrap_or(trajectory).display();
        format!("no relation of {path} has a pose within {max_dt} s of its stamps: is it from another log, or on another clock?")
    });
    output_or_failure(files.output(*json, || report.to_json(), || report.to_text(terminal::width())), problem)
}
