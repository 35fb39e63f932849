//! `anytime info`.

use std::path::PathBuf;

use anyhow::Context as _;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::bag::summary::BagSummary;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

/// Show what a bag holds: topics, rates, scan geometry, problems found
#[derive(Args)]
pub(crate) struct Arguments {
    /// The bag
    bag: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let bag = Bag::open(&arguments.bag)?;
    let style = ProgressStyle::with_template("{wide_bar} {human_pos}/{human_len} messages {eta}")?;
    let progress = ProgressBar::new(bag.message_count(None)).with_style(style);
    let summary = BagSummary::read(&bag, || progress.inc(1))?;
    progress.finish_and_clear();
    if arguments.json {
        let text = serde_json::to_string_pretty(&summary).context("cannot write the summary as JSON")?;
        println!("{text}");
    } else {
        println!("{summary}");
    }
    Ok(())
}
