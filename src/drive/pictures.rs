//! Plots of drives.

use super::course::Course;
use super::figures::{Run, Trace};
use super::study::{Case, Outcome};
use crate::evaluation::plot::{Colour, Dash, Marker, Panel, Path, PlotError, Scale, Series, Style, curves, top_view};

/// Line width of the driven path, pixels.
const WIDTH: u32 = 4;
/// Each curve is wider than the one drawn over it by this much, pixels: equal curves stay visible.
const WIDTH_STEP: u32 = 5;
/// Upper limit, m, legend text and colour of each class of distances from the path.
const ERROR_CLASSES: [(f64, &str, Colour); 4] = [
    (0.05, "up to 5 cm from the path", Colour::Green),
    (0.10, "up to 10 cm", Colour::Orange),
    (0.25, "up to 25 cm", Colour::Vermilion),
    (f64::INFINITY, "more than 25 cm", Colour::Purple),
];

fn error_class(trace: &Trace) -> usize {
    ERROR_CLASSES.iter().position(|(limit, ..)| trace.error <= *limit).unwrap_or(ERROR_CLASSES.len() - 1)
}

/// Plots the walls and the driven path, coloured by its distance from the path to follow.
pub(super) fn path(course: &Course, run: &Run) -> Result<String, PlotError> {
    let mut paths: Vec<Path> = Vec::new();
    for group in run.trace.chunk_by(|a, b| error_class(a) == error_class(b)) {
        let (_, name, colour) = ERROR_CLASSES[error_class(&group[0])];
        let first = paths.last().and_then(|path| path.points.last().copied());
        let points = first.into_iter().chain(group.iter().map(|trace| trace.point)).collect();
        paths.push(Path { name: name.into(), style: Style::line(colour, WIDTH), points });
    }
    top_view(paths, course.wall_points(), "walls")
}

/// Plots the highest speed without a crash by load, with one curve per policy. A speed counts only if no slower one crashed.
pub(super) fn speed_against_load(outcomes: &[Outcome]) -> Result<String, PlotError> {
    let mut policies: Vec<String> = Vec::new();
    for outcome in outcomes {
        let name = outcome.case.policy.to_string();
        if !policies.contains(&name) {
            policies.push(name);
        }
    }
    // Curves that are drawn first are wider, so that policies with equal results all stay visible.
    #[allow(clippy::cast_possible_truncation)] // a few policies
    let below = (0..policies.len() as u32).rev();
    let styles = Colour::CURVES.into_iter().cycle().zip(below).map(|(colour, below)| Style {
        marker: Marker::Disc,
        marker_radius: 8 + WIDTH_STEP * below,
        dash: Dash::Solid,
        ..Style::line(colour, WIDTH + WIDTH_STEP * below)
    });
    let series = policies.iter().zip(styles).map(|(name, style)| Series {
        name: name.clone(),
        style,
        points: highest_speeds(outcomes, name),
    });
    curves(&[Panel {
        x: "load: slowdown of the machine times that of the bursts".into(),
        y: "highest speed without a crash [m/s]".into(),
        scales: (Scale::Logarithmic, Scale::FromZero),
        height: 700,
        series: series.collect(),
    }])
}

/// (load, highest speed without a crash) of a policy.
pub(super) fn highest_speeds(outcomes: &[Outcome], policy: &str) -> Vec<(f64, f64)> {
    let load = |case: &Case| case.load.slowdown * case.load.bursts;
    let mut cases: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.case.policy.to_string() == policy).collect();
    cases.sort_by(|a, b| load(&a.case).total_cmp(&load(&b.case)).then(a.case.speed.total_cmp(&b.case.speed)));
    let of_load = |cases: &[&Outcome]| {
        let safe = cases.iter().take_while(|outcome| outcome.figures.finished == outcome.figures.runs).last();
        (load(&cases[0].case), safe.map_or(0.0, |outcome| outcome.case.speed))
    };
    cases.chunk_by(|a, b| load(&a.case).to_bits() == load(&b.case).to_bits()).map(of_load).collect()
}
