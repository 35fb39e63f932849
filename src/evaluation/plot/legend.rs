//! The legend, in rows above the plot, where it hides nothing.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{self, Dash, Marker, Style};
use super::{Canvas, DrawError};

/// Height of a row, pixels.
const ROW_HEIGHT: u32 = 54;
/// Length of a line sample, pixels.
const SAMPLE: i32 = 84;

/// An entry of the legend.
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) style: Style,
}

/// Estimated width of an entry, pixels. There is no font to measure with; 17 pixels per letter are enough in any sans-serif of this size.
fn width(entry: &Entry) -> u32 {
    SAMPLE.cast_unsigned() + 60 + 17 * u32::try_from(entry.name.chars().count()).unwrap_or(0)
}

/// Left end and row of each entry; the entries flow like text.
fn positions(entries: &[Entry]) -> Vec<(u32, u32)> {
    let (left, right) = (style::MARGIN + style::Y_LABELS, style::WIDTH - style::MARGIN);
    let mut next = (left, 0);
    let position = |entry: &Entry| {
        if next.0 > left && next.0 + width(entry) > right {
            next = (left, next.1 + 1);
        }
        let position = next;
        next.0 += width(entry);
        position
    };
    entries.iter().map(position).collect()
}

/// Height of the legend, pixels.
pub(super) fn height(entries: &[Entry]) -> u32 {
    positions(entries).last().map_or(0, |(_, row)| style::MARGIN + ROW_HEIGHT * (row + 1))
}

pub(super) fn draw(area: &Canvas, entries: &[Entry]) -> Result<(), DrawError> {
    let type_style = style::FONT.into_text_style(area).color(&style::INK).pos(Pos::new(HPos::Left, VPos::Center));
    for (entry, (left, row)) in entries.iter().zip(positions(entries)) {
        let x = left.cast_signed();
        let y = (style::MARGIN + ROW_HEIGHT * row + ROW_HEIGHT / 2).cast_signed();
        match entry.style.dash {
            Dash::None => {}
            Dash::Solid => area.draw(&PathElement::new([(x, y), (x + SAMPLE, y)], entry.style.stroke()))?,
            Dash::Dashed => draw_pieces(area, (x, y), &[0, 31, 62], 22, entry.style)?,
            Dash::Dotted => draw_pieces(area, (x, y), &[0, 16, 32, 48, 64, 78], 6, entry.style)?,
        }
        if entry.style.marker != Marker::None {
            area.draw(&style::marker((x + SAMPLE / 2, y), entry.style))?;
        }
        area.draw(&Text::new(entry.name.as_str(), (x + SAMPLE + 16, y), type_style.clone()))?;
    }
    Ok(())
}

fn draw_pieces(area: &Canvas, (x, y): (i32, i32), starts: &[i32], length: i32, style: Style) -> Result<(), DrawError> {
    starts.iter().try_for_each(|start| area.draw(&PathElement::new([(x + start, y), (x + start + length, y)], style.stroke())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::plot::style::Colour;

    #[test]
    fn entries_flow_into_rows_within_the_picture() {
        let entry = |letters: usize| Entry { name: "x".repeat(letters), style: Style::line(Colour::Blue, 4) };
        let entries: Vec<Entry> = [10, 30, 40, 200, 5].map(entry).into();
        assert_eq!(positions(&entries).iter().map(|(_, row)| *row).collect::<Vec<_>>(), [0, 0, 1, 2, 3]);
        assert_eq!((height(&entries), height(&[])), (style::MARGIN + 4 * ROW_HEIGHT, 0));
    }
}
