//! Panels of the errors of the aligned estimate over time: one for positions, one for headings.

use super::axis::Scale;
use super::curves::{Panel, Series};
use super::style::{Colour, Style};
use crate::evaluation::association::MatchedPose;
use crate::evaluation::ate::Ate;

pub(super) fn panels(ate: &Ate, matched: &[MatchedPose]) -> [Panel; 2] {
    let start = matched.first().map(|m| m.stamp).unwrap_or_default();
    let errors = matched.iter().map(|m| (m.stamp.seconds_since(start), ate.error(m)));
    let (positions, headings) = errors.map(|(t, e)| ((t, 1e3 * e.distance()), (t, e.theta.to_degrees()))).unzip();
    [("error [mm]", positions), ("error [deg]", headings)].map(|(quantity, points)| Panel {
        x: "time [s]".into(),
        y: quantity.into(),
        scales: (Scale::FromZero, Scale::FromZero),
        height: 220,
        series: vec![Series { name: String::new(), style: Style::line(Colour::Blue, 3), points }],
    })
}
