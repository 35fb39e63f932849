//! The legend: lines above the picture, where it hides nothing.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{self, Dash, Look, Mark};
use super::{Canvas, DrawError};

const ROW_HEIGHT: u32 = 54;
/// Length of the sample of a line.
const SAMPLE: i32 = 84;

/// What a sign in the picture stands for.
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) look: Look,
}

/// No font is at hand to measure with: 17 pixels a letter are enough in any sans-serif of this size.
fn width(entry: &Entry) -> u32 {
    SAMPLE.cast_unsigned() + 60 + 17 * u32::try_from(entry.name.chars().count()).unwrap_or(0)
}

/// The entries in columns as wide as the widest asks for.
fn columns(entries: &[Entry]) -> usize {
    let widest = entries.iter().map(width).max().unwrap_or(1);
    (style::PLOT_WIDTH / widest).max(1) as usize
}

/// Height of the legend, pixels.
pub(super) fn height(entries: &[Entry]) -> u32 {
    let rows = u32::try_from(entries.len().div_ceil(columns(entries))).unwrap_or(1);
    if rows == 0 { 0 } else { style::MARGIN + ROW_HEIGHT * rows }
}

pub(super) fn draw(area: &Canvas, entries: &[Entry]) -> Result<(), DrawError> {
    let type_style = style::TYPE.into_text_style(area).color(&style::INK).pos(Pos::new(HPos::Left, VPos::Center));
    let left = (style::MARGIN + style::Y_LABELS).cast_signed();
    let columns = columns(entries);
    // Entries that fit on one line stand close together, as text does.
    let column_width = (entries.len() > columns).then_some(style::PLOT_WIDTH / u32::try_from(columns).unwrap_or(1));
    let mut x = left;
    let mut y = (style::MARGIN + ROW_HEIGHT / 2).cast_signed();
    for (i, entry) in entries.iter().enumerate() {
        if i > 0 && i % columns == 0 {
            (x, y) = (left, y + ROW_HEIGHT.cast_signed());
        }
        let end = (x + SAMPLE, y);
        match entry.look.dash {
            Dash::None => {}
            Dash::Solid => area.draw(&PathElement::new([(x, y), end], entry.look.stroke()))?,
            Dash::Dashed => draw_pieces(area, (x, y), &[0, 31, 62], 22, entry.look)?,
            Dash::Dotted => draw_pieces(area, (x, y), &[0, 16, 32, 48, 64, 78], 6, entry.look)?,
        }
        if entry.look.mark != Mark::None {
            area.draw(&style::mark((x + SAMPLE / 2, y), entry.look))?;
        }
        area.draw(&Text::new(entry.name.as_str(), (x + SAMPLE + 16, y), type_style.clone()))?;
        x += column_width.unwrap_or_else(|| width(entry)).cast_signed();
    }
    Ok(())
}

fn draw_pieces(area: &Canvas, (x, y): (i32, i32), starts: &[i32], length: i32, look: Look) -> Result<(), DrawError> {
    starts.iter().try_for_each(|start| area.draw(&PathElement::new([(x + start, y), (x + start + length, y)], look.stroke())))
}
