//! Sizes in pixels, colours, markers and fonts common to all parts of a picture.

use plotters::element::{DynElement, IntoDynElement};
use plotters::prelude::*;

/// Width of the picture. The backend rounds to whole pixels; a wide picture that browsers scale down keeps curves smooth.
pub(super) const WIDTH: u32 = 1800;
/// Margin of a plot.
pub(super) const MARGIN: u32 = 24;
/// Margin on the right, with room for the protruding half of the last label.
pub(super) const RIGHT_MARGIN: u32 = 54;
/// Height of the labels of the x axis.
pub(super) const X_LABELS: u32 = 90;
/// Width of the labels of the y axis.
pub(super) const Y_LABELS: u32 = 130;
/// Width of a plot without its labels.
pub(super) const PLOT_WIDTH: u32 = WIDTH - MARGIN - RIGHT_MARGIN - Y_LABELS;
/// Height of margins and labels above and below a plot.
pub(super) const SURROUND: u32 = 2 * MARGIN + X_LABELS;
/// Font and its size.
pub(super) const FONT: (&str, u32) = ("sans-serif", 36);

/// Line width of an estimated path.
pub(super) const ESTIMATE_WIDTH: u32 = 4;
/// Line width of the true path.
pub(super) const TRUTH_WIDTH: u32 = 8;

/// Colour of the grid lines.
pub(super) const GRID: RGBColor = RGBColor(232, 234, 237);
/// Colour of text and axes.
pub(super) const INK: RGBColor = RGBColor(60, 60, 60);

/// Colours that colour-blind readers can distinguish (M. Okabe, K. Ito, Color Universal Design, 2008), a grey, and the colour of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // the names say it all
pub enum Colour {
    Blue,
    Orange,
    Green,
    Vermilion,
    Purple,
    SkyBlue,
    Grey,
    Ink,
}

impl Colour {
    /// Colours for the curves of a plot, in this order.
    pub const CURVES: [Self; 6] = [Self::Blue, Self::Vermilion, Self::Green, Self::Purple, Self::Orange, Self::SkyBlue];

    pub(super) fn rgb(self) -> RGBColor {
        match self {
            Self::Blue => RGBColor(0, 114, 178),
            Self::Orange => RGBColor(230, 159, 0),
            Self::Green => RGBColor(0, 158, 115),
            Self::Vermilion => RGBColor(213, 94, 0),
            Self::Purple => RGBColor(204, 121, 167),
            Self::SkyBlue => RGBColor(86, 180, 233),
            Self::Grey => RGBColor(176, 183, 193),
            Self::Ink => INK,
        }
    }
}

/// Dash pattern of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Dash {
    /// No line.
    None,
    Solid,
    Dashed,
    Dotted,
}

/// Marker of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Marker {
    /// No marker.
    None,
    Disc,
    Square,
    Triangle,
}

/// Style of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Colour of line and markers.
    pub colour: Colour,
    /// Opacity, from 0 to 1 (opaque).
    pub opacity: f64,
    /// Width of the line, pixels.
    pub width: u32,
    /// Dash pattern of the line.
    pub dash: Dash,
    /// Marker of each point.
    pub marker: Marker,
    /// Radius of the markers, pixels.
    pub marker_radius: u32,
}

impl Style {
    /// A solid line.
    pub const fn line(colour: Colour, width: u32) -> Self {
        Self { colour, opacity: 1.0, width, dash: Dash::Solid, marker: Marker::None, marker_radius: 9 }
    }

    /// Discs without a line.
    pub const fn discs(colour: Colour, radius: u32) -> Self {
        Self { dash: Dash::None, marker: Marker::Disc, marker_radius: radius, ..Self::line(colour, 0) }
    }

    pub(super) fn stroke(self) -> ShapeStyle {
        self.colour.rgb().mix(self.opacity).stroke_width(self.width)
    }
}

/// The marker of a point at `centre`.
pub(super) fn marker<'b>(centre: (i32, i32), style: Style) -> DynElement<'b, SVGBackend<'b>, (i32, i32)> {
    let fill = style.colour.rgb().mix(style.opacity).filled();
    let radius = style.marker_radius.cast_signed();
    let (x, y) = centre;
    match style.marker {
        Marker::None => EmptyElement::at(centre).into_dyn(),
        Marker::Disc => Circle::new(centre, radius, fill).into_dyn(),
        Marker::Square => Rectangle::new([(x - radius, y - radius), (x + radius, y + radius)], fill).into_dyn(),
        Marker::Triangle => TriangleMarker::new(centre, radius + 2, fill).into_dyn(),
    }
}
