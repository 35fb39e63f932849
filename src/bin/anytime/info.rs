//! `anytime info`.

use std::path::PathBuf;

use anyhow::Context as _;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::bag::summary::BagSummary;
use clap::Args;

use crate::{progress, terminal};

/// Show the contents of a bag: topics, rates, scan geometry, and problems
#[derive(Args)]
pub(crate) struct Arguments {
    /// The bag
    bag: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let bag = Bag::open(&arguments.bag)?;
    let progress = progress::bar(bag.message_count(None))?;
    let summary = BagSummary::read(&bag, || progress.inc(1))?;
    progress.finish_and_clear();
    if arguments.json {
        return serde_json::to_string(&summary).context("cannot write the summary as JSON");
    }
    Ok(summary.to_text(terminal::width()))
}
