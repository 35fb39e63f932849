//! The command line, the width of the terminal, and text wrapping.

use std::env;
use std::io::{self, IsTerminal};

use clap::builder::StyledStr;
use terminal_size::{Width, terminal_size_of};

/// Minimum width for wrapping; narrower terminals are ignored.
const MIN_WIDTH: usize = 20;

/// The command line, without the directory of the program.
pub(crate) fn command_line() -> String {
    let words = env::args().skip(1).map(|word| if word.contains(' ') { format!("'{word}'") } else { word });
    ["anytime".to_owned()].into_iter().chain(words).collect::<Vec<_>>().join(" ")
}

/// Columns of the terminal of standard output, else the value of `COLUMNS`. `None`: a file or a pipe, which needs no wrapping.
pub(crate) fn width() -> Option<usize> {
    let of_terminal = terminal_size_of(io::stdout()).map(|(Width(columns), _)| usize::from(columns));
    let width = of_terminal.or_else(|| env::var("COLUMNS").ok()?.trim().parse().ok());
    width.filter(|width| *width >= MIN_WIDTH)
}

/// The text, with colours only on a terminal.
pub(crate) fn colours(text: &StyledStr) -> String {
    if io::stdout().is_terminal() && env::var_os("NO_COLOR").is_none() { text.ansi().to_string() } else { text.to_string() }
}

/// Wraps long lines at spaces. JSON stays one line.
pub(crate) fn wrap(text: &str, width: Option<usize>) -> String {
    let Some(width) = width.filter(|_| !text.starts_with('{')) else { return text.into() };
    text.lines().map(|line| wrap_line(line, width)).collect::<Vec<_>>().join("\n")
}

/// Wraps a line; continuation lines are indented to its second column.
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

/// Number of visible characters, without colour codes.
fn visible(text: &str) -> usize {
    let mut pieces = text.split('\u{1b}');
    let plain = pieces.next().map_or(0, |text| text.chars().count());
    plain + pieces.map(|piece| piece.split_once('m').map_or(0, |(_, text)| text.chars().count())).sum::<usize>()
}

/// The column of the text after the first run of spaces within a line.
fn second_column(line: &str) -> Option<usize> {
    let start = line.len() - line.trim_start().len();
    let run = start + line[start..].find("  ")?;
    let text = run + (line[run..].len() - line[run..].trim_start().len());
    Some(line[..text].chars().count())
}
