//! `anytime convert`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use anytime_scan_matcher::io::bag::{Bag, BagError, BagWriter, Compression};
use anytime_scan_matcher::io::carmen::{CarmenLog, Mended, Mount, record};
use anytime_scan_matcher::knobs::KnobValue;
use clap::Args;
use serde_json::{Value, json};

use crate::input_flags::Files;

/// Turn a CARMEN log into a bag
#[derive(Args)]
pub(crate) struct Arguments {
    /// The log: lines of FLASER, ROBOTLASER1 or RAWLASER1, and ODOM; packed with bzip2 or gzip, or not
    #[arg(value_name = "IN.clf")]
    log: PathBuf,
    /// The bag to write, with scans, odometry, and where the laser sits
    #[arg(value_name = "OUT.bag")]
    out: PathBuf,
    /// Field of view of FLASER lines, deg, which the log does not state; unset: 180 for an odd number of beams, one beam less for an even number
    #[arg(long, value_name = "DEG", value_parser = field_of_view)]
    fov: Option<f64>,
    /// How the chunks of the bag are packed: none, bz2 or lz4
    #[arg(long, default_value = "lz4", value_parser = |text: &str| Compression::from_value(&text.into()))]
    compression: Compression,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn field_of_view(text: &str) -> Result<f64, String> {
    let degrees = text.trim_end_matches("deg").trim().parse::<f64>().ok().filter(|degrees| (1.0..=360.0).contains(degrees));
    degrees.map(f64::to_radians).ok_or_else(|| "expected 1 to 360 degrees".into())
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let Arguments { log: path, out, fov, compression, json } = arguments;
    let files = Files::default().read("the log", Some(path)).written("the bag", Some(out));
    files.check()?;
    let log = CarmenLog::read(path, *fov).map_err(|error| bag_instead(path).unwrap_or_else(|| error.into()))?;
    record::record(&log, BagWriter::create_whole(out, *compression)?)?;
    let text = in_words(&log, path)?;
    Ok(files.shown(*json, || summary(&log, path), || text))
}

/// What to say of a bag where a log was expected.
fn bag_instead(path: &Path) -> Option<anyhow::Error> {
    match Bag::open(path) {
        Ok(_) => Some(anyhow!("{} is a bag already: replay, localize and map read it as it is", path.display())),
        Err(error @ BagError::Unsupported { .. }) => Some(error.into()),
        Err(_) => None,
    }
}

fn summary(log: &CarmenLog, path: &Path) -> Value {
    let mount = log.mount();
    let damaged = log.damaged.first().map(|(line, problem)| format!("{}:{line}: {problem}", path.display()));
    json!({
        "scans": log.scans.len(),
        "odometry": log.odometry.len(),
        "mended_stamps": log.mended.count,
        "most_mended_s": log.mended.most,
        "mount": match mount {
            Mount::Scans(_) => "scans",
            Mount::Parameter(_) => "parameter",
            Mount::Untold => "untold",
            Mount::Unknown => "unknown",
        },
        "laser_in_base": [mount.laser_in_base().x, mount.laser_in_base().y, mount.laser_in_base().theta],
        "damaged_lines": log.damaged.len(),
        "first_damage": damaged,
        "passed_over": log.passed_over,
    })
}

fn in_words(log: &CarmenLog, path: &Path) -> anyhow::Result<String> {
    let mut text = format!("{} scans", log.scans.len());
    if log.mended.count > 0 {
        let Mended { count, most } = log.mended;
        write!(text, "\n{count} stamps mended, by {most:.3} s at most: the lines are in order, the clock was not")?;
    }
    let where_from = match log.mount() {
        Mount::Scans(_) => None,
        Mount::Parameter(pose) => {
            Some(format!("{} m ahead of base_link, as PARAM says: the scans tell no fixed place on the robot", pose.x))
        }
        Mount::Untold => Some("taken to be at base_link: the scans carry no poses".into()),
        Mount::Unknown => Some("taken to be at base_link: its poses in the scans are no fixed place on the robot".into()),
    };
    if let Some(where_from) = where_from {
        write!(text, "\nlaser {where_from}")?;
    }
    if let Some((line, problem)) = log.damaged.first() {
        write!(text, "\n{} damaged lines left out; the first: {}:{line}: {problem}", log.damaged.len(), path.display())?;
    }
    let passed_over: Vec<String> = log.passed_over.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    if !passed_over.is_empty() {
        write!(text, "\nlines without use for a bag: {}", passed_over.join(", "))?;
    }
    Ok(text)
}
