//! `anytime convert`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use anytime_scan_matcher::io::bag::{Bag, BagError, BagWriter, Compression};
use anytime_scan_matcher::io::carmen::{CarmenLog, Mount, StampRepair, record};
use anytime_scan_matcher::knobs::KnobValue;
use clap::Args;
use serde_json::{Value, json};

use crate::files::Files;

/// Convert a CARMEN log to a bag
#[derive(Args)]
pub(crate) struct Arguments {
    /// The log, with FLASER, ROBOTLASER1 or RAWLASER1 lines and ODOM lines; may be compressed with bzip2 or gzip
    #[arg(value_name = "IN.clf")]
    log: PathBuf,
    /// The bag to write, with scans, odometry and the pose of the laser on the robot
    #[arg(value_name = "OUT.bag")]
    out: PathBuf,
    /// Field of view of FLASER lines, deg, which the log does not contain; unset: 180 for an odd number of beams, one beam less
    /// for an even number
    #[arg(long, value_name = "DEG", value_parser = field_of_view)]
    fov: Option<f64>,
    /// Compression of the bag: none, bz2 or lz4
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
    let log = CarmenLog::read(path, *fov).map_err(|error| bag_error(path).unwrap_or_else(|| error.into()))?;
    record::record(&log, BagWriter::create_whole(out, *compression)?)?;
    let text = in_words(&log, path)?;
    Ok(files.output(*json, || summary(&log, path), || text))
}

/// The error if the log is a bag already.
fn bag_error(path: &Path) -> Option<anyhow::Error> {
    match Bag::open(path) {
        Ok(_) => Some(anyhow!("{} is a bag already: replay, localize and map can read it directly", path.display())),
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
        "mended_stamps": log.stamp_repair.count,
        "most_mended_s": log.stamp_repair.max_change,
        "mount": match mount {
            Mount::Scans(_) => "scans",
            Mount::Parameter(_) => "parameter",
            Mount::NoPoses => "untold",
            Mount::Inconsistent => "unknown",
        },
        "laser_in_base": [mount.laser_in_base().x, mount.laser_in_base().y, mount.laser_in_base().theta],
        "damaged_lines": log.damaged.len(),
        "first_damage": damaged,
        "passed_over": log.skipped,
    })
}

fn in_words(log: &CarmenLog, path: &Path) -> anyhow::Result<String> {
    let mut text = format!("{} scans", log.scans.len());
    if log.stamp_repair.count > 0 {
        let StampRepair { count, max_change } = log.stamp_repair;
        write!(text, "\n{count} stamps corrected, by at most {max_change:.3} s: the lines are in order, but the clock was not")?;
    }
    let mount = match log.mount() {
        Mount::Scans(_) => None,
        Mount::Parameter(pose) => Some(format!(
            "{} m in front of base_link, according to PARAM: the poses of the scans give no fixed position on the robot",
            pose.x
        )),
        Mount::NoPoses => Some("assumed to be at base_link: the scans carry no poses".into()),
        Mount::Inconsistent => {
            Some("assumed to be at base_link: the poses of the scans give no fixed position on the robot".into())
        }
    };
    if let Some(mount) = mount {
        write!(text, "\nlaser {mount}")?;
    }
    if let Some((line, problem)) = log.damaged.first() {
        write!(text, "\n{} damaged lines skipped; the first: {}:{line}: {problem}", log.damaged.len(), path.display())?;
    }
    let skipped: Vec<String> = log.skipped.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    if !skipped.is_empty() {
        write!(text, "\nunused lines: {}", skipped.join(", "))?;
    }
    Ok(text)
}
