//! Arguments of `anytime replay`.

use std::path::PathBuf;

use anytime_scan_matcher::knobs::Value;
use clap::Args;

use crate::files::svg_path;
use crate::input_flags::InputFlags;
use crate::knob_flags::value;

/// Match every scan of a bag, with the same code as the node
#[derive(Args)]
pub(crate) struct Arguments {
    pub(crate) bag: PathBuf,
    /// Time budget from a scan's arrival to its pose, such as 5ms; in seconds without a unit [default: `contract.time_budget`]
    #[arg(long, value_parser = value, allow_hyphen_values = true)]
    pub(crate) time_budget: Option<Value>,
    /// Contracts over time: a CSV file with the columns time (s since the first scan), `time_budget`, `translation_error_bound`,
    /// `rotation_error_bound`
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) contract_schedule: Option<PathBuf>,
    /// Write the pose of every scan to this file
    #[arg(long, value_name = "OUT.tum")]
    pub(crate) tum: Option<PathBuf>,
    /// Write one CSV row per scan to this file
    #[arg(long, value_name = "OUT.csv")]
    pub(crate) csv: Option<PathBuf>,
    /// Plot the trajectory, the scans and the ground truth to this SVG file
    #[arg(long, value_name = "OUT.svg", value_parser = svg_path)]
    pub(crate) plot: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) input: InputFlags,
}
