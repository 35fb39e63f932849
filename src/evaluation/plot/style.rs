//! Sizes in pixels, colours, signs and type that all parts of a picture share.

use plotters::element::{DynElement, IntoDynElement};
use plotters::prelude::*;

/// Width of the picture. The backend rounds to whole pixels: a wide picture, which browsers shrink, keeps curves smooth.
pub(super) const WIDTH: u32 = 1800;
pub(super) const MARGIN: u32 = 24;
/// Room for the half of the last label that stands out.
pub(super) const RIGHT_MARGIN: u32 = 54;
pub(super) const X_LABELS: u32 = 90;
pub(super) const Y_LABELS: u32 = 130;
/// Width of a plot without its labels.
pub(super) const PLOT_WIDTH: u32 = WIDTH - MARGIN - RIGHT_MARGIN - Y_LABELS;
/// What a plot needs above and below itself.
pub(super) const SURROUND: u32 = 2 * MARGIN + X_LABELS;
pub(super) const TYPE: (&str, u32) = ("sans-serif", 36);

pub(super) const ESTIMATE_WIDTH: u32 = 4;
pub(super) const TRUTH_WIDTH: u32 = 8;

pub(super) const GRID: RGBColor = RGBColor(232, 234, 237);
pub(super) const INK: RGBColor = RGBColor(60, 60, 60);

/// Colours distinct to colour-blind readers too: M. Okabe, K. Ito, Color Universal Design, 2008; a grey, and that of the
/// type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // they are what they are called
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
    /// The colours for curves that differ in one thing, in this order.
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

/// How a line is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Dash {
    /// There is no line.
    None,
    Solid,
    Dashed,
    Dotted,
}

/// The sign of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Mark {
    /// There is none.
    None,
    Disc,
    Square,
    Triangle,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Of line and marks.
    pub colour: Colour,
    /// 1: covers what is below.
    pub opacity: f64,
    /// Width of the line, pixels.
    pub width: u32,
    /// How the line is broken.
    pub dash: Dash,
    /// The sign of each point.
    pub mark: Mark,
    /// Radius of the signs, pixels.
    pub mark_radius: u32,
}

impl Look {
    /// A solid line.
    pub const fn line(colour: Colour, width: u32) -> Self {
        Self { colour, opacity: 1.0, width, dash: Dash::Solid, mark: Mark::None, mark_radius: 9 }
    }

    /// Discs, and no line.
    pub const fn discs(colour: Colour, radius: u32) -> Self {
        Self { dash: Dash::None, mark: Mark::Disc, mark_radius: radius, ..Self::line(colour, 0) }
    }

    pub(super) fn stroke(self) -> ShapeStyle {
        self.colour.rgb().mix(self.opacity).stroke_width(self.width)
    }
}

/// The sign of a point at `centre`.
pub(super) fn mark<'b>(centre: (i32, i32), look: Look) -> DynElement<'b, SVGBackend<'b>, (i32, i32)> {
    let fill = look.colour.rgb().mix(look.opacity).filled();
    let radius = look.mark_radius.cast_signed();
    let (x, y) = centre;
    match look.mark {
        Mark::None => EmptyElement::at(centre).into_dyn(),
        Mark::Disc => Circle::new(centre, radius, fill).into_dyn(),
        Mark::Square => Rectangle::new([(x - radius, y - radius), (x + radius, y + radius)], fill).into_dyn(),
        Mark::Triangle => TriangleMarker::new(centre, radius + 2, fill).into_dyn(),
    }
}
