//! Sizes in pixels, colours and type that all parts of a picture share.

use plotters::prelude::*;

/// Width of the picture. The backend rounds to whole pixels: a wide picture, which browsers shrink, keeps curves smooth.
pub(super) const WIDTH: u32 = 1800;
pub(super) const LEGEND_HEIGHT: u32 = 70;
pub(super) const MARGIN: u32 = 24;
pub(super) const X_LABELS: u32 = 90;
pub(super) const Y_LABELS: u32 = 130;
/// Width of a plot without its labels.
pub(super) const PLOT_WIDTH: u32 = WIDTH - 2 * MARGIN - Y_LABELS;
/// What a plot needs above and below itself.
pub(super) const SURROUND: u32 = 2 * MARGIN + X_LABELS;
pub(super) const TYPE: (&str, u32) = ("sans-serif", 36);

pub(super) const ESTIMATE_WIDTH: u32 = 4;
pub(super) const TRUTH_WIDTH: u32 = 8;
pub(super) const MARK_RADIUS: u32 = 12;

// Distinct to colour-blind readers too: M. Okabe, K. Ito, Color Universal Design, 2008.
pub(super) const ESTIMATE: RGBColor = RGBColor(0, 114, 178);
pub(super) const TRUTH: RGBColor = RGBColor(230, 159, 0);
pub(super) const START: RGBColor = RGBColor(0, 158, 115);
pub(super) const END: RGBColor = RGBColor(213, 94, 0);
pub(super) const SCANS: RGBColor = RGBColor(176, 183, 193);
pub(super) const GRID: RGBColor = RGBColor(232, 234, 237);
pub(super) const INK: RGBColor = RGBColor(60, 60, 60);

/// The number at a tick: no more digits than it has (the steps are round, their sums are not quite).
#[allow(clippy::trivially_copy_pass_by_ref)] // the signature that the axes ask for
pub(super) fn tick(value: &f64) -> String {
    let rounded = (value * 1e6).round() / 1e6 + 0.0; // + 0.0: no "-0"
    rounded.to_string()
}
