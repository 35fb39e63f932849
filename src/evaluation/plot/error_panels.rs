//! The errors of the aligned estimate over time: one panel for positions, one for headings.

use plotters::prelude::*;

use super::{Canvas, DrawError, style};
use crate::evaluation::association::MatchedPose;
use crate::evaluation::ate::Ate;

const PANEL_HEIGHT: u32 = 220 + style::SURROUND;
/// Height of both panels.
pub(super) const HEIGHT: u32 = 2 * PANEL_HEIGHT;

pub(super) fn draw(area: &Canvas, ate: &Ate, matched: &[MatchedPose]) -> Result<(), DrawError> {
    let start = matched.first().map(|m| m.stamp).unwrap_or_default();
    let errors = matched.iter().map(|m| (m.stamp.seconds_since(start), ate.error(m)));
    let (positions, headings): (Vec<_>, Vec<_>) =
        errors.map(|(t, e)| ((t, 1e3 * e.distance()), (t, e.theta.to_degrees()))).unzip();
    let (upper, lower) = area.split_vertically(PANEL_HEIGHT);
    draw_panel(&upper, "error [mm]", &positions)?;
    draw_panel(&lower, "error [deg]", &headings)
}

fn draw_panel(area: &Canvas, quantity: &str, curve: &[(f64, f64)]) -> Result<(), DrawError> {
    let end = curve.last().map_or(0.0, |(t, _)| *t).max(1e-3);
    let (low, high) = curve.iter().fold((0.0_f64, 0.0_f64), |(low, high), (_, e)| (low.min(*e), high.max(*e)));
    let air = (0.08 * (high - low)).max(1e-3);
    let low = if low < 0.0 { low - air } else { 0.0 };
    let mut chart = ChartBuilder::on(area)
        .margin(style::MARGIN)
        .x_label_area_size(style::X_LABELS)
        .y_label_area_size(style::Y_LABELS)
        .build_cartesian_2d(0.0..end, low..high + air)?;
    chart
        .configure_mesh()
        .label_style(style::TYPE.into_text_style(area).color(&style::INK))
        .axis_style(style::INK)
        .bold_line_style(style::GRID)
        .light_line_style(TRANSPARENT)
        .x_labels(12)
        .y_labels(4)
        .x_label_formatter(&style::tick)
        .y_label_formatter(&style::tick)
        .x_desc("time [s]")
        .y_desc(quantity)
        .draw()?;
    chart.draw_series(LineSeries::new(curve.iter().copied(), style::ESTIMATE.stroke_width(3)))?;
    Ok(())
}
