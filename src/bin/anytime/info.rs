//! `anytime info`.

use clap::Args;

/// Show what a bag holds: topics, rates, scan geometry, problems found
#[derive(Args)]
pub(crate) struct Arguments {}

pub(crate) fn run(_arguments: &Arguments) -> anyhow::Result<()> {
    anyhow::bail!("not built yet")
}
