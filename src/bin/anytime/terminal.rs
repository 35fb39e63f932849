//! The width of the terminal, and text that fits it.

use std::env;
use std::io::{self, IsTerminal};

use clap::builder::StyledStr;
use terminal_size::{Width, terminal_size_of};

/// Nothing is broken into lines shorter than this.
const MIN_WIDTH: usize = 20;

/// Columns of the terminal that standard output is; else what `COLUMNS` says. `None`: a file or a pipe, which is as wide as need be.
pub(crate) fn width() -> Option<usize> {
    let of_terminal = terminal_size_of(io::stdout()).map(|(Width(columns), _)| usize::from(columns));
    let width = of_terminal.or_else(|| env::var("COLUMNS").ok()?.trim().parse().ok());
    width.filter(|width| *width >= MIN_WIDTH)
}

/// Text with its colours where a person sees them.
pub(crate) fn colours(text: &StyledStr) -> String {
    if io::stdout().is_terminal() && env::var_os("NO_COLOR").is_none() { text.ansi().to_string() } else { text.to_string() }
}

/// Breaks lines between words where they are too long. JSON stays one line.
pub(crate) fn wrap(text: &str, width: Option<usize>) -> String {
    let Some(width) = width.filter(|_| !text.starts_with('{')) else { return text.into() };
    text.lines().map(|line| wrap_line(line, width)).collect::<Vec<_>>().join("\n")
}

/// What follows the first line of a row begins where its second column does.
fn wrap_line(line: &str, width: usize) -> String {
    if visible(line) <= width {
        return line.into();
    }
    let hanging = second_column(line).filter(|column| 2 * column < width).unwrap_or(2);
    let indent = line.len() - line.trim_start().len();
    let mut wrapped = " ".repeat(indent);
    let mut column = indent;
    let mut gap = "";
    for word in line.trim_start().split_inclusive(' ') {
        let (word, spaces) = word.split_at(word.trim_end_matches(' ').len());
        if column + gap.len() + visible(word) > width && column > hanging {
            wrapped.push('\n');
            wrapped.push_str(&" ".repeat(hanging));
            column = hanging;
        } else {
            wrapped.push_str(gap);
            column += gap.len();
        }
        wrapped.push_str(word);
        column += visible(word);
        gap = spaces;
    }
    wrapped
}

/// Number of characters, without the codes of colours.
fn visible(text: &str) -> usize {
    let mut parts = text.split('\u{1b}');
    let plain = parts.next().map_or(0, |text| text.chars().count());
    plain + parts.map(|part| part.split_once('m').map_or(0, |(_, text)| text.chars().count())).sum::<usize>()
}

/// Where the text after the first run of spaces within a line begins.
fn second_column(line: &str) -> Option<usize> {
    let start = line.len() - line.trim_start().len();
    let run = start + line[start..].find("  ")?;
    let text = run + (line[run..].len() - line[run..].trim_start().len());
    Some(line[..text].chars().count())
}
