//! `anytime simulate`.

use clap::Args;

/// Drive a simulated racecar and write its scans and odometry to a bag
#[derive(Args)]
pub(crate) struct Arguments {}

pub(crate) fn run(_arguments: &Arguments) -> anyhow::Result<()> {
    anyhow::bail!("not built yet")
}
