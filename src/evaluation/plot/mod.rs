//! Plots of trajectories and curves, as SVG pictures.

mod axis;
mod curves;
mod error_panels;
mod legend;
mod style;
mod top_view;

use std::io;
use std::path::PathBuf;

use plotters::prelude::*;
use thiserror::Error;

use super::association::{AssociationError, associate};
use super::ate::ate;
use super::trajectory::Trajectory;
use crate::geometry::{Point, Pose2};
use crate::output;
pub use axis::Scale;
pub use curves::{Panel, Series, curves};
pub use style::{Colour, Dash, Marker, Style};
pub use top_view::Path;
use top_view::TopView;

/// Why a plot failed.
#[derive(Debug, Error)]
pub enum PlotError {
    /// Estimate and truth hardly overlap in time.
    #[error(transparent)]
    Association(#[from] AssociationError),
    /// Coordinates or errors are too large to draw.
    #[error("cannot draw: the numbers of the trajectory are too large (has it diverged, or are its columns mixed up?)")]
    TooLarge,
    /// The drawing failed.
    #[error("cannot draw: {0}")]
    Draw(DrawError),
    /// The file cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

type DrawError = DrawingAreaErrorKind<io::Error>;
type Canvas<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Draws the top view of a trajectory to an SVG file, over its scan points if given.
///
/// With truth, the estimate and the scan points are aligned with it, and two panels show the errors over time; `max_dt` is the
/// tolerance of the association, s.
pub fn trajectory_plot(
    path: &std::path::Path,
    estimate: &Trajectory,
    truth: Option<&Trajectory>,
    scan_points: Option<&[Point]>,
    max_dt: f64,
) -> Result<(), PlotError> {
    let matched = truth.map(|truth| associate(estimate, truth, max_dt)).transpose()?.unwrap_or_default();
    let ate = ate(&matched);
    let frame = ate.map_or(Pose2::IDENTITY, |ate| ate.truth_from_estimate);
    let name = ate.map_or("estimate".into(), |ate| format!("estimate (ATE {:.3} m rmse)", ate.errors.trans_m.rmse));
    let mut paths: Vec<_> = truth.map(true_path).into_iter().collect();
    paths.push(Path { name, style: Style::line(Colour::Blue, style::ESTIMATE_WIDTH), points: positions(estimate, &frame) });
    let transform = frame.transform();
    let background = scan_points.unwrap_or_default().iter().map(|p| transform.apply(*p)).collect();
    let panels = ate.map(|ate| error_panels::panels(&ate, &matched));
    let view = TopView { paths, background, background_name: "scans" };
    let svg = top_view_with(&view, panels.as_ref().map_or(&[], |panels| panels))?;
    write(path, &svg)
}

/// The truth as a path to be drawn first: wide enough to show below an estimate.
pub fn true_path(truth: &Trajectory) -> Path {
    let style = Style::line(Colour::Orange, style::TRUTH_WIDTH);
    Path { name: "truth".into(), style, points: positions(truth, &Pose2::IDENTITY) }
}

/// The positions of a trajectory, transformed by `transform`.
pub fn positions(trajectory: &Trajectory, transform: &Pose2) -> Vec<Point> {
    let transform = transform.transform();
    trajectory.poses().iter().map(|p| transform.apply(p.pose.translation())).collect()
}

/// Renders paths over background points (scans or walls, named `background_name`) as an SVG picture, with markers at the ends of the
/// last path.
pub fn top_view(paths: Vec<Path>, background: Vec<Point>, background_name: &'static str) -> Result<String, PlotError> {
    top_view_with(&TopView { paths, background, background_name }, &[])
}

/// Renders legend, top view and panels, stacked vertically.
fn top_view_with(view: &TopView, panels: &[Panel]) -> Result<String, PlotError> {
    let window = view.window();
    if !window.is_finite() || !panels.iter().all(Panel::is_finite) {
        return Err(PlotError::TooLarge);
    }
    let entries = view.legend();
    let legend_height = legend::height(&entries);
    let view_height = window.height + style::SURROUND;
    render(legend_height + view_height + panels.iter().map(Panel::total_height).sum::<u32>(), |root| {
        let (legend, rest) = root.split_vertically(legend_height);
        legend::draw(&legend, &entries)?;
        let (top_view, rest) = rest.split_vertically(view_height);
        view.draw(&top_view, &window)?;
        curves::draw_panels(rest, panels)
    })
}

/// Renders a white picture of this height; `draw` draws on it.
fn render(height: u32, draw: impl FnOnce(&Canvas) -> Result<(), DrawError>) -> Result<String, PlotError> {
    let mut svg = String::new();
    let root = SVGBackend::with_string(&mut svg, (style::WIDTH, height)).into_drawing_area();
    root.fill(&WHITE).and_then(|()| draw(&root)).and_then(|()| root.present()).map_err(PlotError::Draw)?;
    drop(root); // it borrows the text
    Ok(svg)
}

/// Writes an SVG picture to a file.
pub fn write(path: &std::path::Path, svg: &str) -> Result<(), PlotError> {
    output::write(path, svg).map_err(|source| PlotError::Write { path: path.into(), source })
}
