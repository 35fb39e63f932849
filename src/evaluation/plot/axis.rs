//! Linear and logarithmic axes, and the frame of a plot with its ticks and labels.

use std::ops::Range;

use plotters::coord::ranged1d::{BoldPoints, KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::{Canvas, DrawError, style};

/// Margin beyond the outermost values, as a fraction of their range.
const MARGIN: f64 = 0.08;
/// Minimum number of ticks; fewer do not show the scale.
const MIN_TICKS: usize = 3;

/// Scale of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Linear; the values fill the axis.
    Linear,
    /// Linear, and including zero.
    FromZero,
    /// Logarithmic; values that are not positive are left out.
    Logarithmic,
}

impl Scale {
    /// Whether a value can be shown on the axis.
    pub(super) fn accepts(self, value: f64) -> bool {
        value.is_finite() && (self != Self::Logarithmic || value > 0.0)
    }

    /// Creates an axis that shows `values` with a margin.
    pub(super) fn axis(self, values: impl Iterator<Item = f64>) -> Axis {
        let accepted = values.filter(|&v| self.accepts(v)).map(|v| if self == Self::Logarithmic { v.ln() } else { v });
        let origin = if self == Self::FromZero { (0.0, 0.0) } else { (f64::INFINITY, f64::NEG_INFINITY) };
        let (low, high) = accepted.fold(origin, |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let margin = (MARGIN * (high - low)).max(if self == Self::Logarithmic { 0.1 } else { 1e-3 });
        match self {
            Self::Linear => Axis::linear(low - margin..high + margin),
            Self::FromZero => Axis::linear(if low < 0.0 { low - margin } else { 0.0 }..high + margin),
            Self::Logarithmic => Axis { logarithmic: true, range: low - margin..high + margin },
        }
    }
}

/// One axis of a plot.
#[derive(Clone)]
pub(super) struct Axis {
    logarithmic: bool,
    /// Range of the values, or of their natural logarithms.
    range: Range<f64>,
}

impl Axis {
    pub(super) fn linear(range: Range<f64>) -> Self {
        Self { logarithmic: false, range }
    }

    /// Whether the axis can be drawn: the backend panics on infinite ranges.
    pub(super) fn is_finite(&self) -> bool {
        (self.range.end - self.range.start).is_finite()
    }

    fn inner(&self) -> RangedCoordf64 {
        self.range.clone().into()
    }

    /// Powers of ten, and their multiples by 2 and 5 if there is room; over a short range, evenly spaced values.
    fn logarithmic_ticks(&self, max: usize) -> Vec<f64> {
        let within = self.range();
        #[allow(clippy::cast_possible_truncation)] // exponents of finite numbers: a few hundred
        let exponent = |v: f64| (v / std::f64::consts::LN_10).floor() as i32;
        let decades = exponent(self.range.start)..=exponent(self.range.end);
        let ticks = |digits: &[f64]| -> Vec<f64> {
            let at = |exponent: i32| digits.iter().map(move |digit| digit * 10_f64.powi(exponent));
            decades.clone().flat_map(at).filter(|tick| within.contains(tick)).collect()
        };
        let fine = ticks(&[1.0, 2.0, 5.0]);
        match fine.len() {
            count if count < MIN_TICKS => RangedCoordf64::from(self.range()).key_points(BoldPoints(max)),
            count if count > max => ticks(&[1.0]),
            _ => fine,
        }
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.inner().map(&if self.logarithmic { value.ln() } else { *value }, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if self.logarithmic { self.logarithmic_ticks(hint.bold_points()) } else { self.inner().key_points(hint) }
    }

    fn range(&self) -> Range<f64> {
        if self.logarithmic { self.range.start.exp()..self.range.end.exp() } else { self.range.clone() }
    }
}

impl ValueFormatter<f64> for Axis {
    /// Rounds a tick: the steps are round numbers, but their floating-point sums are not.
    fn format(value: &f64) -> String {
        let rounded = (value * 1e6).round() / 1e6 + 0.0; // + 0.0: no "-0"
        rounded.to_string()
    }
}

/// Labels of the axes, and the maximum number of ticks along y.
pub(super) struct Labels<'a> {
    pub(super) x: &'a str,
    pub(super) y: &'a str,
    pub(super) y_ticks: usize,
}

/// A plot with its axes, ready for curves.
pub(super) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;

/// Draws the frame of a plot that fills `area`.
pub(super) fn frame<'a, 'b>(area: &'a Canvas<'b>, x: Axis, y: Axis, labels: &Labels) -> Result<Chart<'a, 'b>, DrawError> {
    let mut chart = ChartBuilder::on(area)
        .margin(style::MARGIN)
        .margin_right(style::RIGHT_MARGIN)
        .x_label_area_size(style::X_LABELS)
        .y_label_area_size(style::Y_LABELS)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .label_style(style::FONT.into_text_style(area).color(&style::INK))
        .axis_style(style::INK)
        .bold_line_style(style::GRID)
        .light_line_style(TRANSPARENT)
        .x_labels(12)
        .y_labels(labels.y_ticks)
        .x_desc(labels.x)
        .y_desc(labels.y)
        .draw()?;
    Ok(chart)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(low: f64, high: f64) -> Vec<f64> {
        Scale::Logarithmic.axis([low, high].into_iter()).key_points(BoldPoints(8))
    }

    #[test]
    fn logarithmic_ticks_are_round_and_not_too_few() {
        assert_eq!(ticks(1.0, 10.0), [1.0, 2.0, 5.0, 10.0]);
        assert_eq!(ticks(1e-3, 1e5).len(), 9);
        assert!(ticks(6.0, 6.5).len() >= MIN_TICKS);
        assert!(ticks(1.0, 1.0).len() >= MIN_TICKS);
    }

    #[test]
    fn values_on_an_axis_are_in_view() {
        let accepts = |scale: Scale, values: &[f64], value: f64| scale.axis(values.iter().copied()).range().contains(&value);
        assert!(accepts(Scale::FromZero, &[3.0, 4.0], 0.0) && accepts(Scale::FromZero, &[-3.0, -1.0], -3.0));
        assert!(accepts(Scale::Linear, &[3.0, f64::NAN], 3.0) && !accepts(Scale::Linear, &[3.0, 4.0], 0.0));
        assert!(accepts(Scale::Logarithmic, &[0.0, -1.0, 5.0], 5.0));
        assert!(Scale::Logarithmic.axis([].into_iter()).is_finite());
        assert!(!Scale::Linear.axis([-1e308, 1e308].into_iter()).is_finite());
    }
}
