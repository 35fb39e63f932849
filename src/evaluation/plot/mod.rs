//! Trajectories as SVG pictures, fit for a README.

mod error_panels;
mod legend;
mod style;
mod top_view;

use std::io;
use std::path::{Path, PathBuf};

use plotters::prelude::*;
use thiserror::Error;

use super::association::{AssociationError, MatchedPose, associate};
use super::ate::{Ate, ate};
use super::trajectory::Trajectory;
use crate::geometry::{Point, Pose2};
use top_view::TopView;

/// Why a picture was not made.
#[derive(Debug, Error)]
pub enum PlotError {
    /// Estimate and truth hardly meet in time.
    #[error(transparent)]
    Association(#[from] AssociationError),
    /// Coordinates or errors near the end of the number range.
    #[error("cannot draw: the numbers of the trajectory are too large (is it diverged, or are its columns mixed up?)")]
    TooLarge,
    /// The drawing failed.
    #[error("cannot draw: {0}")]
    Draw(DrawError),
    /// The file cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

type DrawError = DrawingAreaErrorKind<io::Error>;
type Canvas<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Draws the top view of a trajectory to an SVG file, over the points of its scans if given.
///
/// With truth the estimate is aligned to it (the scan points with it), and two panels show the errors over time; `max_dt` is the
/// tolerance of the association in seconds.
pub fn trajectory_plot(
    path: &Path,
    estimate: &Trajectory,
    truth: Option<&Trajectory>,
    scan_points: Option<&[Point]>,
    max_dt: f64,
) -> Result<(), PlotError> {
    let matched = truth.map(|truth| associate(estimate, truth, max_dt)).transpose()?.unwrap_or_default();
    let ate = ate(&matched);
    let frame = ate.map_or(Pose2::IDENTITY, |ate| ate.truth_from_estimate).transform();
    let positions = |trajectory: &Trajectory| trajectory.poses().iter().map(|p| p.pose.translation()).collect::<Vec<_>>();
    let view = TopView {
        estimate: positions(estimate).into_iter().map(|p| frame.apply(p)).collect(),
        truth: truth.map(positions).unwrap_or_default(),
        scan_points: scan_points.unwrap_or_default().iter().map(|p| frame.apply(*p)).collect(),
    };
    // The backend panics on axes without end.
    if !view.window().is_finite() || ate.is_some_and(|ate| !ate.errors.trans_m.rmse.is_finite()) {
        return Err(PlotError::TooLarge);
    }
    let svg = draw(&view, ate.as_ref(), &matched).map_err(PlotError::Draw)?;
    std::fs::write(path, svg).map_err(|source| PlotError::Write { path: path.into(), source })
}

/// Legend, top view and error panels, one above the other.
fn draw(view: &TopView, ate: Option<&Ate>, matched: &[MatchedPose]) -> Result<String, DrawError> {
    let window = view.window();
    let panels_top = style::LEGEND_HEIGHT + window.height + style::SURROUND;
    let panels_height = if ate.is_some() { error_panels::HEIGHT } else { 0 };
    let mut svg = String::new();
    let root = SVGBackend::with_string(&mut svg, (style::WIDTH, panels_top + panels_height)).into_drawing_area();
    root.fill(&WHITE)?;
    let (above, panels) = root.split_vertically(panels_top);
    let (legend, top_view) = above.split_vertically(style::LEGEND_HEIGHT);
    legend::draw(&legend, view, ate)?;
    view.draw(&top_view, &window)?;
    if let Some(ate) = ate {
        error_panels::draw(&panels, ate, matched)?;
    }
    root.present()?;
    drop((root, above, panels, legend, top_view)); // they hold on to the text
    Ok(svg)
}
