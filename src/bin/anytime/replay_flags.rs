//! Arguments of `anytime replay`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock, VirtualClock};
use clap::{Args, ValueEnum};

use crate::configuration::Configuration;

/// Time that passes on the virtual clock at each reading.
const VIRTUAL_TICK: Duration = Duration::from_micros(10);

/// Match every scan of a bag, through the very code the node runs
#[derive(Args)]
pub(crate) struct Arguments {
    pub(crate) bag: PathBuf,
    /// Topic of the laser scans
    #[arg(long, default_value = "/scan")]
    pub(crate) scan_topic: String,
    /// Topic of the wheel odometry [default: /odom, if the bag has it]
    #[arg(long)]
    pub(crate) odom_topic: Option<String>,
    /// True poses to compare with: a TUM file, or a topic of the bag
    #[arg(long, value_name = "FILE|TOPIC")]
    pub(crate) truth: Option<String>,
    /// Time that a scan's answer may take, such as 5ms [default: `contract.time_budget`]
    #[arg(long, value_parser = humantime::parse_duration)]
    pub(crate) time_budget: Option<Duration>,
    /// Contracts over time: a CSV file with the columns time (s since the first scan), `time_budget`, `translation_error_bound`,
    /// `rotation_error_bound`
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) contract_schedule: Option<PathBuf>,
    /// The clock of the contract; with `virtual` all files of two runs are equal to the byte
    #[arg(long, value_enum, default_value = "monotonic")]
    pub(crate) clock: ClockChoice,
    /// Write the pose of every scan
    #[arg(long, value_name = "OUT.tum")]
    pub(crate) tum: Option<PathBuf>,
    /// Write a line of figures for every scan
    #[arg(long, value_name = "OUT.csv")]
    pub(crate) csv: Option<PathBuf>,
    /// Draw the trajectory, the scans and the truth
    #[arg(long, value_name = "OUT.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) configuration: Configuration,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum ClockChoice {
    Monotonic,
    Virtual,
}

impl ClockChoice {
    pub(crate) fn clock(self) -> Arc<dyn Clock> {
        match self {
            Self::Monotonic => Arc::new(MonotonicClock::default()),
            Self::Virtual => Arc::new(VirtualClock::new(VIRTUAL_TICK)),
        }
    }
}
