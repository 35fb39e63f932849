//! `anytime simulate`.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use anytime_scan_matcher::io::bag::{BagWriter, Compression};
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::io::{map_file, simulated_bag};
use anytime_scan_matcher::knobs::KnobValue;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{DriveKnobs, Settings};
use anytime_scan_matcher::simulation::scene::Scene;
use clap::Args;
use serde_json::json;

use crate::files::{Files, create};
use crate::knob_flags::help;
use crate::simulation_flags::{SimulationFlags, check_world};

/// Simulate a racecar and record its scans and odometry in a bag
#[derive(Args)]
pub(crate) struct Arguments {
    /// The environment: corridor, room, or the YAML file of a map
    #[arg(long)]
    world: String,
    /// The bag to write
    #[arg(long, value_name = "X.bag")]
    out: PathBuf,
    /// Write the true pose of every scan to a TUM file
    #[arg(long, value_name = "X.tum")]
    truth: Option<PathBuf>,
    /// Compression of the bag: none, bz2 or lz4
    #[arg(long, default_value = "lz4", value_parser = |text: &str| Compression::from_value(&text.into()))]
    compression: Compression,
    #[arg(long, default_value_t = DriveKnobs::default().seed, hide_default_value = true, help = help::<DriveKnobs>("seed"))]
    seed: u32,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    flags: SimulationFlags,
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let Arguments { world, out, truth, compression, seed, json, flags } = arguments;
    let files = Files::default()
        .read_map("--world", Some(Path::new(world)))
        .written("--out", Some(out))
        .written("--truth", truth.as_deref());
    files.check()?;
    let scans = drive(world, &flags.settings(*seed)?, out, *compression, truth.as_deref())?;
    Ok(files.output(*json, || json!({ "scans": scans }), || format!("{scans} scans")))
}

/// Records a simulated drive in a bag, and its true poses in a TUM file; returns the number of scans.
pub(crate) fn drive(
    world: &str,
    settings: &Settings,
    out: &Path,
    compression: Compression,
    truth: Option<&Path>,
) -> anyhow::Result<u64> {
    let scene = scene(world, settings.drive.seed)?;
    let mut file = truth.map(create).transpose()?;
    let bag = BagWriter::create_whole(out, compression)?;
    // The true poses are few: one line per scan.
    let mut poses = Vec::new();
    let scans = simulated_bag::record(settings, &scene, bag, TumWriter::new(&mut poses))?;
    if let (Some(file), Some(path)) = (&mut file, truth) {
        file.write_all(&poses).and_then(|()| file.commit()).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(scans)
}

fn scene(world: &str, seed: u32) -> anyhow::Result<Scene> {
    check_world(world)?;
    match BuiltIn::from_value(&world.into()) {
        Ok(which) => Ok(Scene::built_in(which)?),
        Err(expected) => {
            let map = map_file::read(Path::new(world)).with_context(|| format!("--world: {expected}, or a map"))?;
            Scene::in_map(map, seed).with_context(|| format!("--world {world}"))
        }
    }
}
