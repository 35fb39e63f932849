//! The arguments for reading a bag: topics, truth, clock and parameters.

use std::sync::Arc;
use std::time::Duration;

#[cfg(target_os = "linux")]
use anytime_scan_matcher::anytime::clock::ProcessorClock;
use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock, VirtualClock};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::io::bag::{Bag, BagError};
use anytime_scan_matcher::replay::Topics;
use clap::{Args, ValueEnum};

use crate::configuration::Configuration;

/// Time by which the virtual clock advances at each reading.
const VIRTUAL_TICK: Duration = Duration::from_micros(10);

#[derive(Args)]
pub(crate) struct InputFlags {
    /// Topic of the laser scans or point clouds [default: /scan; with `cloud.input` /cloud]
    #[arg(long)]
    scan_topic: Option<String>,
    /// Topic of the wheel odometry [default: /odom, if the bag has it]
    #[arg(long)]
    odom_topic: Option<String>,
    /// Topic of an IMU [default: /imu/data, if the bag has it]
    #[arg(long)]
    imu_topic: Option<String>,
    /// Ignore odometry and IMU, even if the bag has them
    #[arg(long, conflicts_with_all = ["odom_topic", "imu_topic"])]
    scan_only: bool,
    /// True poses for comparison: a TUM file, or a topic of the bag
    #[arg(long, value_name = "FILE|TOPIC")]
    pub(crate) truth: Option<String>,
    /// Clock of the contract; with `virtual`, repeated runs write identical files
    #[arg(long, value_enum, default_value = "monotonic")]
    pub(crate) clock: ClockChoice,
    #[command(flatten)]
    pub(crate) configuration: Configuration,
}

impl InputFlags {
    pub(crate) fn topics(&self, bag: &Bag, config: &Config) -> Result<Topics, BagError> {
        let default = if config.cloud.input { "/cloud" } else { "/scan" };
        let topics = Topics::resolve(bag, self.scan_topic.as_deref().unwrap_or(default), self.odom_topic.as_deref())?;
        if self.scan_only { Ok(topics.scan_only()) } else { topics.with_imu(bag, self.imu_topic.as_deref()) }
    }
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum ClockChoice {
    /// Wall clock
    Monotonic,
    /// Processor time of the computation, as on an idle machine
    #[cfg(target_os = "linux")]
    Processor,
    /// Advances by a fixed step at each reading: the same on every machine
    Virtual,
}

impl ClockChoice {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Monotonic => "monotonic",
            #[cfg(target_os = "linux")]
            Self::Processor => "processor",
            Self::Virtual => "virtual",
        }
    }

    /// Adapts the configuration: processor time is measured for one thread, which must do all the work.
    pub(crate) fn prepare(self, config: &mut Config) {
        if self.name() == "processor" {
            config.localization.threads = 1;
        }
    }

    pub(crate) fn clock(self) -> Arc<dyn Clock> {
        match self {
            Self::Monotonic => Arc::new(MonotonicClock::default()),
            #[cfg(target_os = "linux")]
            Self::Processor => Arc::new(ProcessorClock),
            Self::Virtual => Arc::new(VirtualClock::new(VIRTUAL_TICK)),
        }
    }
}
