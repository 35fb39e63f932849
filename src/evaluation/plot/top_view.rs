//! The top view: truth, estimate and scan points in the plane, with equal scales of both axes.

use std::collections::BTreeSet;
use std::ops::Range;

use plotters::prelude::*;

use super::axis::{Axis, Labels, frame};
use super::curves::draw_line;
use super::legend::Entry;
use super::style::{self, Colour, Style};
use super::{Canvas, DrawError};
use crate::geometry::Point;

/// Minimum and maximum height of the plot, pixels.
const HEIGHTS: (f64, f64) = (500.0, 1500.0);
/// Side length of the squares that represent scan points, pixels.
const CELL: f64 = 3.0;

/// Marker of the start of a path.
const START: Style = Style::discs(Colour::Green, 12);
/// Marker of the end of a path.
const END: Style = Style::discs(Colour::Vermilion, 12);

/// A path in the plane.
#[derive(Clone, Debug)]
pub struct Path {
    /// Name in the legend; paths with the same name share an entry.
    pub name: String,
    /// Style of the line.
    pub style: Style,
    /// Points of the path, m.
    pub points: Vec<Point>,
}

/// The contents of the top view, in one frame.
pub(super) struct TopView {
    /// Paths; the last one is on top, with markers at its ends.
    pub(super) paths: Vec<Path>,
    /// Points of scans or walls behind the paths; may be empty.
    pub(super) background: Vec<Point>,
    /// Name of the background points in the legend.
    pub(super) background_name: &'static str,
}

/// The visible part of the plane.
pub(super) struct Window {
    x: Range<f64>,
    y: Range<f64>,
    /// Height of the plot, pixels.
    pub(super) height: u32,
    metres_per_pixel: f64,
}

impl Window {
    pub(super) fn is_finite(&self) -> bool {
        [self.x.start, self.x.end, self.y.start, self.y.end, self.metres_per_pixel].iter().all(|v| v.is_finite())
    }
}

impl TopView {
    /// The window that shows everything, as large as the width or the maximum height of the picture allows.
    pub(super) fn window(&self) -> Window {
        let (x, y) = (self.extent(|p| p.x), self.extent(|p| p.y));
        let (width_m, height_m) = (x.end - x.start, y.end - y.start);
        let width = f64::from(style::PLOT_WIDTH);
        let height = (width * height_m / width_m).clamp(HEIGHTS.0, HEIGHTS.1).round();
        let metres_per_pixel = (width_m / width).max(height_m / height);
        let around = |extent: &Range<f64>, pixels: f64| {
            let (middle, half) = (f64::midpoint(extent.start, extent.end), 0.5 * metres_per_pixel * pixels);
            middle - half..middle + half
        };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped above
        Window { x: around(&x, width), y: around(&y, height), height: height as u32, metres_per_pixel }
    }

    /// The range to show along one axis, with a margin: whole paths, and all scan points except the outermost 1 % on each side.
    fn extent(&self, coordinate: fn(&Point) -> f64) -> Range<f64> {
        let mut scans: Vec<f64> = self.background.iter().map(coordinate).collect();
        scans.sort_by(f64::total_cmp);
        let outermost = scans.len() / 100;
        let paths = self.paths.iter().flat_map(|path| &path.points).map(coordinate);
        let (low, high) = paths
            .chain(scans[outermost..scans.len() - outermost].iter().copied())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let margin = (0.04 * (high - low)).max(0.5);
        low - margin..high + margin
    }

    pub(super) fn draw(&self, area: &Canvas, window: &Window) -> Result<(), DrawError> {
        let labels = Labels { x: "x [m]", y: "y [m]", y_ticks: (window.height / 100) as usize };
        let mut chart = frame(area, Axis::linear(window.x.clone()), Axis::linear(window.y.clone()), &labels)?;
        let side = CELL * window.metres_per_pixel;
        let bar = |(row, columns): (i32, Range<i32>)| {
            let at = |column: i32| window.x.start + side * f64::from(column);
            let bottom = window.y.start + side * f64::from(row);
            let top = bottom + side + window.metres_per_pixel; // overlaps the next row: rounding must leave no gap
            Rectangle::new([(at(columns.start), top), (at(columns.end), bottom)], Colour::Grey.rgb().filled())
        };
        chart.draw_series(self.scan_runs(window, side).into_iter().map(bar))?;
        for path in &self.paths {
            let points: Vec<_> = path.points.iter().map(|p| (p.x, p.y)).collect();
            draw_line(&mut chart, &points, path.style)?;
        }
        let ends = self.paths.last().map(|path| (path.points.first(), path.points.last()));
        let (start, end) = ends.unwrap_or_default();
        for (marker, style) in [(start, START), (end, END)] {
            let disc = |radius, colour: RGBColor| marker.map(|p| Circle::new((p.x, p.y), radius, colour.filled()));
            let above = disc(style.marker_radius, style.colour.rgb());
            chart.draw_series(disc(style.marker_radius + 4, WHITE).into_iter().chain(above))?;
        }
        Ok(())
    }

    /// Entries of the legend.
    pub(super) fn legend(&self) -> Vec<Entry> {
        let entry = |name: &str, style| Entry { name: name.to_owned(), style };
        let mut entries: Vec<Entry> = Vec::new();
        for path in &self.paths {
            if entries.iter().all(|entry| entry.name != path.name) {
                entries.push(entry(&path.name, path.style));
            }
        }
        entries.extend([entry("start", START), entry("end", END)]);
        if !self.background.is_empty() {
            entries.push(entry(self.background_name, Style::discs(Colour::Grey, START.marker_radius)));
        }
        entries
    }

    /// Runs of neighbouring cells that contain scan points, as row and columns from the window's lower left. A log has millions of
    /// points, but a picture has room for only thousands.
    fn scan_runs(&self, window: &Window, side: f64) -> Vec<(i32, Range<i32>)> {
        #[allow(clippy::cast_possible_truncation)] // within the window: a few hundred
        let index = |v: f64, start: f64| ((v - start) / side) as i32;
        let in_view = |p: &&Point| window.x.contains(&p.x) && window.y.contains(&p.y);
        let cell = |p: &Point| (index(p.y, window.y.start), index(p.x, window.x.start));
        let cells: BTreeSet<_> = self.background.iter().filter(in_view).map(cell).collect();
        let mut runs: Vec<(i32, Range<i32>)> = Vec::new();
        for (row, column) in cells {
            match runs.last_mut() {
                Some((last_row, columns)) if *last_row == row && columns.end == column => columns.end += 1,
                _ => runs.push((row, column..column + 1)),
            }
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths(points: &[Point]) -> Vec<Path> {
        vec![Path { name: "estimate".into(), style: Style::line(Colour::Blue, 4), points: points.to_vec() }]
    }

    #[test]
    fn scan_points_merge_into_runs_and_hidden_ones_are_left_out() {
        let scan_points = [(0.1, 0.1), (0.2, 0.3), (1.5, 0.5), (3.5, 0.5), (0.5, 2.5), (9.0, 0.5), (0.5, -0.1)];
        let scan_points = scan_points.map(|(x, y)| Point::new(x, y)).to_vec();
        let view = TopView { paths: paths(&[Point::zeros()]), background: scan_points, background_name: "scans" };
        let window = Window { x: 0.0..5.0, y: 0.0..5.0, height: 500, metres_per_pixel: 0.01 };
        assert_eq!(view.scan_runs(&window, 1.0), [(0, 0..2), (0, 3..4), (2, 0..1)]);
    }

    #[test]
    fn both_axes_have_the_same_scale_and_everything_is_in_view() {
        for (x, y) in [(0.0, 0.0), (100.0, 1.0), (1.0, 100.0), (30.0, 20.0)] {
            let view =
                TopView { paths: paths(&[Point::zeros(), Point::new(x, y)]), background: vec![], background_name: "scans" };
            let Window { x: across, y: up, height, metres_per_pixel } = view.window();
            assert!(across.contains(&0.0) && across.contains(&x) && up.contains(&0.0) && up.contains(&y));
            for (extent, pixels) in [(across, style::PLOT_WIDTH), (up, height)] {
                assert!(((extent.end - extent.start) / f64::from(pixels) - metres_per_pixel).abs() < 1e-12);
            }
        }
    }
}
