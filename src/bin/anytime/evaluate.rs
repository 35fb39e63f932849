//! `anytime evaluate`.

use clap::Args;

/// Compare a trajectory with the truth: ATE, RPE, relations
#[derive(Args)]
pub(crate) struct Arguments {}

pub(crate) fn run(_arguments: &Arguments) -> anyhow::Result<()> {
    anyhow::bail!("not built yet")
}
