//! Curves: named series in stacked panels, with a common legend.

use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::axis::{Axis, Chart, Labels, Scale, frame};
use super::legend::{self, Entry};
use super::style::{self, Dash, Marker, Style};
use super::{Canvas, DrawError, PlotError, render};

/// Minimum distance between two points of a line, pixels; points in between are dropped.
const MIN_POINT_DISTANCE: i32 = 2;

/// A series of points.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend. Series with the same name share an entry; those without a name have none.
    pub name: String,
    /// Style of line and markers.
    pub style: Style,
    /// The points, in the order of the line through them. Points that an axis cannot show are left out.
    pub points: Vec<(f64, f64)>,
}

/// A plot of several series over common axes.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Label of the x axis, with its unit.
    pub x: String,
    /// Label of the y axis, with its unit.
    pub y: String,
    /// Scales of the x and the y axis.
    pub scales: (Scale, Scale),
    /// Height of the plot, pixels; the picture is 1800 pixels wide.
    pub height: u32,
    /// The series; the last one is on top.
    pub series: Vec<Series>,
}

/// Renders the panels as an SVG picture.
pub fn curves(panels: &[Panel]) -> Result<String, PlotError> {
    if !panels.iter().all(Panel::is_finite) {
        return Err(PlotError::TooLarge);
    }
    let mut entries: Vec<Entry> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if !series.name.is_empty() && entries.iter().all(|entry| entry.name != series.name) {
            entries.push(Entry { name: series.name.clone(), style: series.style });
        }
    }
    let legend_height = legend::height(&entries);
    let heights = panels.iter().map(Panel::total_height);
    render(legend_height + heights.sum::<u32>(), |root| {
        let (legend, rest) = root.split_vertically(legend_height);
        legend::draw(&legend, &entries)?;
        draw_panels(rest, panels)
    })
}

/// Draws the panels one below the other.
pub(super) fn draw_panels(area: Canvas, panels: &[Panel]) -> Result<(), DrawError> {
    panels.iter().try_fold(area, |area, panel| {
        let (upper, rest) = area.split_vertically(panel.total_height());
        panel.draw(&upper).map(|()| rest)
    })?;
    Ok(())
}

impl Panel {
    /// Height of the plot with its surroundings, pixels.
    pub(super) fn total_height(&self) -> u32 {
        self.height + style::SURROUND
    }

    fn axes(&self) -> (Axis, Axis) {
        let points = || self.series.iter().flat_map(|series| &series.points);
        (self.scales.0.axis(points().map(|p| p.0)), self.scales.1.axis(points().map(|p| p.1)))
    }

    /// Whether the panel can be drawn: the backend panics on infinite axes.
    pub(super) fn is_finite(&self) -> bool {
        let (x, y) = self.axes();
        x.is_finite() && y.is_finite()
    }

    fn draw(&self, area: &Canvas) -> Result<(), DrawError> {
        let (x, y) = self.axes();
        let y_ticks = (self.height / 60).max(4) as usize;
        let mut chart = frame(area, x, y, &Labels { x: &self.x, y: &self.y, y_ticks })?;
        self.series.iter().try_for_each(|series| self.draw_series(&mut chart, series))
    }

    fn draw_series(&self, chart: &mut Chart, series: &Series) -> Result<(), DrawError> {
        let is_shown = |&&(x, y): &&(f64, f64)| self.scales.0.accepts(x) && self.scales.1.accepts(y);
        let points: Vec<(f64, f64)> = series.points.iter().filter(is_shown).copied().collect();
        let style = series.style;
        draw_line(chart, &points, style)?;
        if style.marker == Marker::None {
            return Ok(());
        }
        let area = chart.plotting_area().strip_coord_spec();
        let (across, down) = area.get_pixel_range();
        points
            .iter()
            .map(|point| chart.backend_coord(point))
            .try_for_each(|(x, y)| area.draw(&style::marker((x - across.start, y - down.start), style)))
    }
}

/// Draws a line through the points, without points that make no visible difference.
pub(super) fn draw_line(chart: &mut Chart, points: &[(f64, f64)], style: Style) -> Result<(), DrawError> {
    let stroke = style.stroke();
    let points = thinned(points, |point| chart.backend_coord(point));
    match style.dash {
        Dash::None => {}
        Dash::Solid => drop(chart.draw_series(LineSeries::new(points, stroke))?),
        Dash::Dashed => drop(chart.draw_series([DashedPathElement::new(points, 22, 14, stroke)])?),
        Dash::Dotted => drop(chart.draw_series([DashedPathElement::new(points, 6, 10, stroke)])?),
    }
    Ok(())
}

/// Drops points nearer to the previous one than [`MIN_POINT_DISTANCE`]; keeps the last point.
fn thinned(points: &[(f64, f64)], pixel: impl Fn(&(f64, f64)) -> (i32, i32)) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    let mut last_pixel = None;
    for (i, point) in points.iter().enumerate() {
        let (x, y) = pixel(point);
        let moved = last_pixel.is_none_or(|(u, v): (i32, i32)| (x - u).abs().max((y - v).abs()) >= MIN_POINT_DISTANCE);
        if moved || i + 1 == points.len() {
            kept.push(*point);
            last_pixel = Some((x, y));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::plot::style::Colour;

    fn panel(points: Vec<(f64, f64)>, scale: Scale) -> Panel {
        let style = Style { dash: Dash::Dashed, marker: Marker::Square, ..Style::line(Colour::Blue, 4) };
        let series = vec![Series { name: "a<b".into(), style, points }];
        Panel { x: "time [s]".into(), y: "error [m]".into(), scales: (scale, scale), height: 300, series }
    }

    #[test]
    fn all_numbers_give_a_picture_or_an_error() {
        let odd = vec![(1.0, f64::NAN), (0.0, 2.0), (3.0, f64::INFINITY), (5.0, 5.0), (5.0, 5.0)];
        for scale in [Scale::Linear, Scale::FromZero, Scale::Logarithmic] {
            let svg = curves(&[panel(odd.clone(), scale), panel(vec![], scale)]).unwrap();
            assert!(svg.ends_with("</svg>\n") && svg.matches("a&lt;b").count() == 1, "one entry in the legend: {svg}");
        }
        assert!(curves(&[panel(vec![(-1e308, 0.0), (1e308, 1.0)], Scale::Linear)]).is_err());
        assert!(curves(&[]).is_ok());
    }

    #[test]
    fn lines_are_thinned_to_the_visible_points() {
        let many: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i) * 1e-4, 0.0)).collect();
        #[allow(clippy::cast_possible_truncation)]
        let kept = thinned(&many, |(x, y)| ((x * 100.0) as i32, *y as i32));
        assert!(kept.len() <= 501 && kept.last() == many.last(), "{}", kept.len());
    }
}
