//! The legend: a line above the picture, where it hides nothing.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::top_view::TopView;
use super::{Canvas, DrawError, style};
use crate::evaluation::ate::Ate;

enum Sign {
    Line(u32),
    Dot,
}

pub(super) fn draw(area: &Canvas, view: &TopView, ate: Option<&Ate>) -> Result<(), DrawError> {
    let estimate = ate.map_or("estimate".into(), |ate| format!("estimate (ATE {:.3} m rmse)", ate.errors.trans_m.rmse));
    let mut entries = Vec::new();
    if !view.truth.is_empty() {
        entries.push(("truth".to_owned(), style::TRUTH, Sign::Line(style::TRUTH_WIDTH)));
    }
    entries.push((estimate, style::ESTIMATE, Sign::Line(style::ESTIMATE_WIDTH)));
    entries.push(("start".to_owned(), style::START, Sign::Dot));
    entries.push(("end".to_owned(), style::END, Sign::Dot));
    if !view.scan_points.is_empty() {
        entries.push(("scans".to_owned(), style::SCANS, Sign::Dot));
    }

    let type_style = style::TYPE.into_text_style(area).color(&style::INK).pos(Pos::new(HPos::Left, VPos::Center));
    let (mut x, y) = ((style::MARGIN + style::Y_LABELS).cast_signed(), style::LEGEND_HEIGHT.cast_signed() / 2 + 8);
    for (text, colour, sign) in entries {
        match sign {
            Sign::Line(width) => area.draw(&PathElement::new([(x, y), (x + 60, y)], colour.stroke_width(width)))?,
            Sign::Dot => area.draw(&Circle::new((x + 44, y), style::MARK_RADIUS, colour.filled()))?,
        }
        area.draw(&Text::new(text.as_str(), (x + 76, y), type_style.clone()))?;
        // No font is at hand to measure with: 15 pixels a letter are enough in any sans-serif of this size.
        x += 120 + 15 * i32::try_from(text.len()).unwrap_or(0);
    }
    Ok(())
}
