//! Pictures of drives.

use super::course::Course;
use super::figures::{Run, Trace};
use super::study::{Case, Outcome};
use crate::evaluation::plot::{Colour, Dash, Look, Mark, Panel, Path, PlotError, Scale, Series, curves, top_view};

/// Width of the path as driven, pixels.
const WIDTH: u32 = 4;
/// By so much what is drawn first is wider than what comes upon it, pixels.
const WIDER: u32 = 5;
/// Colours of distances from the path up to, m.
const CLASSES: [(f64, &str, Colour); 4] = [
    (0.05, "up to 5 cm off", Colour::Green),
    (0.10, "up to 10 cm", Colour::Orange),
    (0.25, "up to 25 cm", Colour::Vermilion),
    (f64::INFINITY, "more", Colour::Purple),
];

fn class(trace: &Trace) -> usize {
    CLASSES.iter().position(|(limit, ..)| trace.error <= *limit).unwrap_or(CLASSES.len() - 1)
}

/// The path of a run, coloured by its distance from the one to follow, between the walls.
pub(super) fn path(course: &Course, run: &Run) -> Result<String, PlotError> {
    let mut paths: Vec<Path> = Vec::new();
    for group in run.trace.chunk_by(|a, b| class(a) == class(b)) {
        let (_, name, colour) = CLASSES[class(&group[0])];
        let first = paths.last().and_then(|path| path.points.last().copied());
        let points = first.into_iter().chain(group.iter().map(|trace| trace.point)).collect();
        paths.push(Path { name: name.into(), look: Look::line(colour, WIDTH), points });
    }
    top_view(paths, course.wall_points(), "walls")
}

/// The highest speed without a crash against the load, one curve a policy. A speed counts if all slower ones are without a crash, too.
pub(super) fn speed_against_load(outcomes: &[Outcome]) -> Result<String, PlotError> {
    let mut policies: Vec<String> = Vec::new();
    for outcome in outcomes {
        let name = outcome.case.policy.to_string();
        if !policies.contains(&name) {
            policies.push(name);
        }
    }
    // Policies that are equally good are all to be seen: what is drawn first is wider.
    #[allow(clippy::cast_possible_truncation)] // a few
    let below = (0..policies.len() as u32).rev();
    let looks = Colour::CURVES.into_iter().cycle().zip(below).map(|(colour, below)| Look {
        mark: Mark::Disc,
        mark_radius: 8 + WIDER * below,
        dash: Dash::Solid,
        ..Look::line(colour, WIDTH + WIDER * below)
    });
    let series =
        policies.iter().zip(looks).map(|(name, look)| Series { name: name.clone(), look, points: highest(outcomes, name) });
    curves(&[Panel {
        x: "load: slow-down of the machine, times that of bursts".into(),
        y: "highest speed without a crash [m/s]".into(),
        scales: (Scale::Logarithmic, Scale::FromZero),
        height: 700,
        series: series.collect(),
    }])
}

/// Load and highest safe speed of a policy.
pub(super) fn highest(outcomes: &[Outcome], policy: &str) -> Vec<(f64, f64)> {
    let load = |case: &Case| case.load.slowdown * case.load.bursts;
    let mut cases: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.case.policy.to_string() == policy).collect();
    cases.sort_by(|a, b| load(&a.case).total_cmp(&load(&b.case)).then(a.case.speed.total_cmp(&b.case.speed)));
    let of_load = |cases: &[&Outcome]| {
        let safe = cases.iter().take_while(|outcome| outcome.figures.finished == outcome.figures.runs).last();
        (load(&cases[0].case), safe.map_or(0.0, |outcome| outcome.case.speed))
    };
    cases.chunk_by(|a, b| load(&a.case).to_bits() == load(&b.case).to_bits()).map(of_load).collect()
}
