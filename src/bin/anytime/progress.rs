//! The progress bar: on stderr, and only if that is a terminal.

use indicatif::{ProgressBar, ProgressStyle};

pub(crate) fn bar(messages: u64) -> anyhow::Result<ProgressBar> {
    let style = ProgressStyle::with_template("{wide_bar} {human_pos}/{human_len} messages, {eta} left")?;
    Ok(ProgressBar::new(messages).with_style(style))
}
