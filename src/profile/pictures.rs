//! The pictures of a study.

use super::ProfileError;
use super::knob::Knob;
use super::results::{Results, VariantCost};
use super::run::Run;
use super::summary::CaseSummary;
use super::variant::Variant;
use crate::evaluation::plot::{Colour, Dash, Look, Mark, Panel, Path, Scale, Series, curves, positions, top_view, true_path};
use crate::geometry::{Point, Pose2, wrap_angle};
use crate::matching::classic::correspondence::Correspondence;
use crate::matching::solver::SolverKind;
use crate::quantile;

/// Values of a knob that a picture of whole trajectories can hold apart.
const SHOWN_VALUES: usize = 4;

/// A picture and what it shows.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Name of its file, without the ending.
    pub name: String,
    /// Title, for people.
    pub title: String,
    /// What is to be seen.
    pub caption: String,
    /// The picture.
    pub svg: String,
}

/// All pictures of a study, in the order of the report.
pub fn draw(results: &Results) -> Result<Vec<Picture>, ProfileError> {
    let mut pictures = Vec::new();
    for knob in results.knobs() {
        if knob != Knob::UpdatePeriod {
            pictures.push(delay_error(results, knob)?);
        }
        if matches!(knob, Knob::Particles | Knob::UpdatePeriod) {
            pictures.push(error_by_value(results, knob)?);
        }
    }
    pictures.push(trajectories(results)?);
    pictures.push(poses(results)?);
    pictures.push(pose_errors(results)?);
    pictures.push(delay_by_iterations(results)?);
    pictures.push(descents(results)?);
    pictures.push(search_times(results)?);
    Ok(pictures)
}

fn position<T: PartialEq>(all: &[T], one: &T) -> usize {
    all.iter().position(|other| other == one).unwrap_or(0)
}

fn colour(index: usize) -> Colour {
    Colour::CURVES[index % Colour::CURVES.len()]
}

/// Lines and signs of the searches, in the order of their declaration.
const SEARCH_LOOKS: [(Dash, Mark); 6] = [
    (Dash::Dotted, Mark::Triangle),
    (Dash::Solid, Mark::Disc),
    (Dash::Dashed, Mark::Square),
    (Dash::Solid, Mark::Square),
    (Dash::Dashed, Mark::Triangle),
    (Dash::Dotted, Mark::Disc),
];

/// Colour by solver, line and sign by search.
fn look(variant: Variant) -> Look {
    let Variant::Matcher { search, solver } = variant else { return filter_look() };
    let (dash, mark) = SEARCH_LOOKS[position(Correspondence::ALL, &search) % SEARCH_LOOKS.len()];
    Look { dash, mark, ..Look::line(colour(position(SolverKind::ALL, &solver)), 4) }
}

fn filter_look() -> Look {
    Look { mark: Mark::Disc, ..Look::line(colour(SolverKind::ALL.len()), 7) }
}

/// Series without points that name the solvers of curves by their colours.
fn solver_legend(curves: &[Variant]) -> Vec<Series> {
    let is_there = |solver: &&SolverKind| curves.iter().any(|variant| variant.solver() == Some(**solver));
    let entry = |solver: &SolverKind| Series {
        name: solver.name().into(),
        look: Look::line(colour(position(SolverKind::ALL, solver)), 14),
        points: Vec::new(),
    };
    SolverKind::ALL.iter().filter(is_there).map(entry).collect()
}

/// Series without points that name the searches of curves by their lines and signs.
fn search_legend(curves: &[Variant]) -> Vec<Series> {
    let is_there = |search: &&Correspondence| curves.iter().any(|variant| variant.search() == Some(**search));
    let entry = |&search: &Correspondence| Series {
        name: search.name().into(),
        look: Look { colour: Colour::Ink, ..look(Variant::Matcher { search, solver: SolverKind::PointToLine }) },
        points: Vec::new(),
    };
    Correspondence::ALL.iter().filter(is_there).map(entry).collect()
}

fn panel(x: &str, y: &str, scales: (Scale, Scale), height: u32, series: Vec<Series>) -> Panel {
    Panel { x: x.into(), y: y.into(), scales, height, series }
}

fn delay_error(results: &Results, knob: Knob) -> Result<Picture, ProfileError> {
    type Error = fn(&CaseSummary) -> f64;
    let mut variants = results.variants();
    variants.retain(|&variant| !results.of(variant, knob).is_empty());
    let curve = |variant: Variant, error: Error| Series {
        name: if variant == Variant::Filter { variant.to_string() } else { String::new() },
        look: look(variant),
        points: results.of(variant, knob).into_iter().map(|case| (case.figures.delay.p50, error(case))).collect(),
    };
    let of_all = |label: &str, error: Error| {
        let mut series = [solver_legend(&variants), search_legend(&variants)].concat();
        series.extend(variants.iter().map(|&variant| curve(variant, error)));
        panel("median delay [us]", label, (Scale::Logarithmic, Scale::Logarithmic), 560, series)
    };
    let panels = [
        of_all("position RMSE [mm]", |case| 1e3 * case.figures.position.rmse()),
        of_all("orientation RMSE [deg]", |case| case.figures.orientation.rmse().to_degrees()),
    ];
    let mut values: Vec<f64> = results.cases.iter().filter(|case| case.case.knob == knob).map(|case| case.case.value).collect();
    values.sort_by(|a, b| knob.rank(*a).total_cmp(&knob.rank(*b)));
    values.dedup();
    let values: Vec<String> = values.into_iter().map(|value| knob.show(value)).collect();
    Ok(Picture {
        name: format!("delay_error_{}", knob.name()),
        title: format!("Delay and error by {}", knob.name()),
        caption: format!(
            "A sign for each value of {}: {}. Delay: from a scan's arrival to its answer, the median over all scans and then over the \
             rounds. Error: root mean square after alignment. Colours are solvers; lines and signs are searches.{}",
            knob.name(),
            values.join(", "),
            difference_of_searches(&results.cases, knob)
        ),
        svg: curves(&panels)?,
    })
}

/// By how much the errors of searches for the nearest ray differ, of cases alike in all else; empty where there are no such cases.
fn difference_of_searches(cases: &[CaseSummary], knob: Knob) -> String {
    let seeks_nearest = |case: &&CaseSummary| case.case.variant.search().is_some_and(|search| search.search().is_some());
    let nearest: Vec<_> = cases.iter().filter(|case| case.case.knob == knob).filter(seeks_nearest).collect();
    // Values are compared as they are shown.
    let asked = |case: &CaseSummary| (case.case.variant.solver(), knob.show(case.case.value));
    let mut largest: Option<f64> = None;
    for (i, one) in nearest.iter().enumerate() {
        for other in nearest[i + 1..].iter().filter(|other| asked(other) == asked(one)) {
            let difference = (one.figures.position.rmse() - other.figures.position.rmse()).abs();
            largest = Some(largest.map_or(difference, |largest| largest.max(difference)));
        }
    }
    largest.map_or_else(String::new, |difference| {
        format!(
            " With equal solver and value, searches for the nearest ray differ by at most {:.3} mm in position.",
            1e3 * difference
        )
    })
}

/// The filter's error by the value of a knob, and beside it the best that a scan matcher has done in this study.
fn error_by_value(results: &Results, knob: Knob) -> Result<Picture, ProfileError> {
    type Error = fn(&CaseSummary) -> f64;
    let cases = results.of(Variant::Filter, knob);
    let ends = [cases.first(), cases.last()].map(|case| case.map_or(0.0, |case| case.case.value));
    let matchers = || results.cases.iter().filter(|case| case.case.variant != Variant::Filter);
    let best = matchers().min_by(|a, b| a.figures.position.rmse().total_cmp(&b.figures.position.rmse()));
    let of = |label: &str, error: Error| {
        let points = cases.iter().map(|case| (case.case.value, error(case))).collect();
        let mut series = vec![Series { name: Variant::Filter.to_string(), look: filter_look(), points }];
        series.extend(best.map(|best| Series {
            name: best.case.variant.to_string(),
            look: Look { mark: Mark::None, dash: Dash::Dashed, ..look(best.case.variant) },
            points: ends.map(|value| (value, error(best))).into(),
        }));
        let x = if knob.unit().is_empty() { knob.name().to_owned() } else { format!("{} [{}]", knob.name(), knob.unit()) };
        panel(&x, label, (Scale::Logarithmic, Scale::Logarithmic), 440, series)
    };
    let panels = [
        of("position RMSE [mm]", |case| 1e3 * case.figures.position.rmse()),
        of("orientation RMSE [deg]", |case| case.figures.orientation.rmse().to_degrees()),
    ];
    Ok(Picture {
        name: format!("error_{}", knob.name()),
        title: format!("The particle filter's error by {}", knob.name()),
        caption:
            "Root mean square after alignment, at every scan; at scans that no update took in, of the last belief carried on by \
                  odometry. Dashed: the scan matcher whose error was least in this study, whatever its knobs."
                .into(),
        svg: curves(&panels)?,
    })
}

/// The cases that stand for the study: some of its values, the first and the last among them.
fn shown(results: &Results) -> Vec<usize> {
    let all = results.showcase();
    let count = all.len().min(SHOWN_VALUES);
    (0..count).filter_map(|k| all.get(k * (all.len() - 1) / (count - 1).max(1)).copied()).collect()
}

fn case_name(case: &CaseSummary) -> String {
    format!("{} {}", case.case.knob.name(), case.case.knob.show(case.case.value))
}

fn case_words(results: &Results) -> String {
    shown(results).first().map_or_else(String::new, |&i| results.cases[i].case.variant.to_string())
}

fn trajectories(results: &Results) -> Result<Picture, ProfileError> {
    let chosen = shown(results);
    let mut paths = vec![true_path(&results.truth)];
    for (n, &i) in chosen.iter().enumerate() {
        let run = &results.first_runs[i];
        let points = positions(&run.trajectory()?, &run.truth_from_map);
        let name = format!("{} ({:.1} mm)", case_name(&results.cases[i]), 1e3 * results.cases[i].figures.position.rmse());
        paths.push(Path { name, look: Look::line(path_colour(n), 4), points });
    }
    let scan_points: Vec<Point> = chosen.last().map_or_else(Vec::new, |&i| {
        let run = &results.first_runs[i];
        let transform = run.truth_from_map.transform();
        run.scan_points.iter().map(|&point| transform.apply(point)).collect()
    });
    Ok(Picture {
        name: "trajectories".into(),
        title: "Trajectories over the map".into(),
        caption: format!(
            "{}, each aligned to the truth; in brackets the root mean square error of the positions. Grey: the scans, at the poses of the \
             last one.",
            case_words(results)
        ),
        svg: top_view(paths, scan_points, "scans")?,
    })
}

/// Not the truth's orange.
fn path_colour(n: usize) -> Colour {
    [Colour::Vermilion, Colour::Purple, Colour::Green, Colour::Blue][n % SHOWN_VALUES]
}

/// A trajectory as (seconds since the first scan, aligned pose, true pose).
fn aligned(results: &Results, run: &Run) -> Vec<(f64, Pose2, Pose2)> {
    let start = run.scans.first().map(|scan| scan.stamp).unwrap_or_default();
    let aligned = run.scans.iter().filter_map(|scan| {
        let truth = results.truth.interpolated(scan.stamp).filter(|_| scan.error.is_some())?;
        Some((scan.stamp.seconds_since(start), run.truth_from_map * scan.map_from_base, truth))
    });
    aligned.collect()
}

/// Three quantities over time.
struct PoseCurve {
    name: String,
    look: Look,
    /// Seconds, and the quantities then.
    points: Vec<(f64, [f64; 3])>,
}

/// A panel for each quantity.
fn pose_panels(labels: [&str; 3], curves: &[PoseCurve]) -> Vec<Panel> {
    let series = |k: usize| {
        let of = |curve: &PoseCurve| Series {
            name: curve.name.clone(),
            look: curve.look,
            points: curve.points.iter().map(|(t, values)| (*t, values[k])).collect(),
        };
        curves.iter().map(of).collect()
    };
    (0..3).map(|k| panel("time [s]", labels[k], (Scale::Linear, Scale::Linear), 300, series(k))).collect()
}

fn poses(results: &Results) -> Result<Picture, ProfileError> {
    let unwrapped = |poses: Vec<(f64, Pose2)>| {
        let mut heading: Option<f64> = None;
        let values = poses.into_iter().map(|(t, pose)| {
            let unwrapped = heading.map_or(pose.theta, |before| before + wrap_angle(pose.theta - before));
            heading = Some(unwrapped);
            (t, [pose.x, pose.y, unwrapped.to_degrees()])
        });
        values.collect::<Vec<_>>()
    };
    let mut all = Vec::new();
    for (n, &i) in shown(results).iter().enumerate() {
        let poses = aligned(results, &results.first_runs[i]);
        if n == 0 {
            let truth = poses.iter().map(|(t, _, truth)| (*t, *truth)).collect();
            all.push(PoseCurve { name: "truth".into(), look: Look::line(Colour::Orange, 8), points: unwrapped(truth) });
        }
        let estimate = poses.iter().map(|(t, pose, _)| (*t, *pose)).collect();
        let (name, look) = (case_name(&results.cases[i]), Look::line(path_colour(n), 3));
        all.push(PoseCurve { name, look, points: unwrapped(estimate) });
    }
    Ok(Picture {
        name: "poses".into(),
        title: "Pose by pose".into(),
        caption: format!("{} against the truth, aligned; headings count whole turns.", case_words(results)),
        svg: curves(&pose_panels(["x [m]", "y [m]", "theta [deg]"], &all))?,
    })
}

fn pose_errors(results: &Results) -> Result<Picture, ProfileError> {
    let chosen = shown(results);
    let all = chosen.iter().enumerate().map(|(n, &i)| {
        let error = |(t, pose, truth): (f64, Pose2, Pose2)| {
            (t, [1e3 * (pose.x - truth.x), 1e3 * (pose.y - truth.y), wrap_angle(pose.theta - truth.theta).to_degrees()])
        };
        let points = aligned(results, &results.first_runs[i]).into_iter().map(error).collect();
        PoseCurve { name: case_name(&results.cases[i]), look: Look::line(path_colour(n), 3), points }
    });
    let all: Vec<_> = all.collect();
    Ok(Picture {
        name: "pose_errors".into(),
        title: "Errors, pose by pose".into(),
        caption: "The same poses less the true ones, in the frame of the truth.".into(),
        svg: curves(&pose_panels(["x error [mm]", "y error [mm]", "theta error [deg]"], &all))?,
    })
}

fn delay_by_iterations(results: &Results) -> Result<Picture, ProfileError> {
    let of_search = |&search: &Correspondence| {
        let has_points = |cost: &&VariantCost| cost.variant.search() == Some(search) && !cost.levels.is_empty();
        let costs: Vec<_> = results.costs.iter().filter(has_points).collect();
        if costs.is_empty() {
            return None;
        }
        let variants: Vec<Variant> = costs.iter().map(|cost| cost.variant).collect();
        let series = costs.into_iter().flat_map(|cost| {
            let look = look(cost.variant);
            let points = cost.levels.iter().map(|level| (f64::from(level.iterations), 1e-3 * level.delay_us)).collect();
            let line = cost.model.map(|model| {
                let at_levels = cost.levels.iter().map(|level| (f64::from(level.iterations), 1e-3 * model.delay_us(level.rays)));
                [(0.0, 1e-3 * model.setup_us)].into_iter().chain(at_levels).collect()
            });
            [
                Series { name: String::new(), look: Look { mark: Mark::None, ..look }, points: line.unwrap_or_default() },
                Series { name: String::new(), look: Look { dash: Dash::None, mark_radius: 11, ..look }, points },
            ]
        });
        let series = solver_legend(&variants).into_iter().chain(series).collect();
        let label = format!("{} [ms]", search.name());
        Some(panel("iterations", &label, (Scale::FromZero, Scale::FromZero), 320, series))
    };
    let panels: Vec<Panel> = Correspondence::ALL.iter().filter_map(of_search).collect();
    Ok(Picture {
        name: "delay_by_iterations".into(),
        title: "Delay by iterations, and the fitted cost".into(),
        caption: "Signs: the median delay of all answers that took so many iterations. Lines: setup plus so much per ray of \
                  each iteration (the first ones take few), by the weighted median of slopes, which answers that were held up do not move."
            .into(),
        svg: curves(&panels)?,
    })
}

/// Every match of a sample as a thin line, and their median: a match that has ended keeps its last value.
fn descents(results: &Results) -> Result<Picture, ProfileError> {
    let search = results.showcase().first().map(|&i| results.cases[i].case.variant.search());
    let of_solver = |solver: &SolverKind| {
        let of_solver = results
            .cases
            .iter()
            .zip(&results.first_runs)
            .filter(|(case, _)| Some(case.case.variant.search()) == search && case.case.variant.solver() == Some(*solver));
        // The run that stopped matches least.
        let run = of_solver.map(|(_, run)| run).max_by_key(|run| run.descents.iter().map(Vec::len).sum::<usize>())?;
        if run.descents.is_empty() {
            return None;
        }
        let in_mm =
            |residuals: &[f64]| -> Vec<(f64, f64)> { (1..).map(f64::from).zip(residuals.iter().map(|r| 1e3 * r)).collect() };
        let thin = Look { opacity: 0.6, ..Look::line(Colour::Grey, 2) };
        let mut series: Vec<Series> =
            run.descents.iter().map(|descent| Series { name: "a match".into(), look: thin, points: in_mm(descent) }).collect();
        let look = Look { mark: Mark::Disc, ..Look::line(colour(position(SolverKind::ALL, solver)), 5) };
        series.push(Series { name: format!("median, {}", solver.name()), look, points: in_mm(&median_descent(&run.descents)) });
        Some(panel("iteration", "mean residual [mm]", (Scale::Linear, Scale::Logarithmic), 320, series))
    };
    let panels: Vec<Panel> = SolverKind::ALL.iter().filter_map(of_solver).collect();
    Ok(Picture {
        name: "residual_by_iteration".into(),
        title: "The metric, iteration by iteration".into(),
        caption: "Mean absolute error of the inliers before each iteration: each thin line is a match, of a sample spread over the drive; \
                  thick is the median, for which a match that has ended keeps its last value."
            .into(),
        svg: curves(&panels)?,
    })
}

fn median_descent(descents: &[Vec<f64>]) -> Vec<f64> {
    let longest = descents.iter().map(Vec::len).max().unwrap_or(0);
    let at = |i: usize| {
        let mut values: Vec<f64> = descents.iter().filter_map(|descent| descent.get(i).or(descent.last()).copied()).collect();
        values.sort_by(f64::total_cmp);
        quantile::of_sorted(&values, 0.5)
    };
    (0..longest).filter_map(at).collect()
}

fn search_times(results: &Results) -> Result<Picture, ProfileError> {
    let of_search = |&search: &Correspondence| {
        let times = results.search_times.iter().filter(|time| time.search == search);
        let style = look(Variant::Matcher { search, solver: SolverKind::PointToLine });
        Series {
            name: search.name().into(),
            look: Look { colour: colour(position(Correspondence::ALL, &search)), ..style },
            points: times.map(|time| (time.beams as f64, time.time_us)).collect(),
        }
    };
    let series = Correspondence::ALL.iter().map(of_search).filter(|series| !series.points.is_empty()).collect();
    let panels = [panel("beams", "time of a search [us]", (Scale::Logarithmic, Scale::Logarithmic), 640, series)];
    Ok(Picture {
        name: "search_time".into(),
        title: "Time of the searches for the nearest ray".into(),
        caption: "One search for all points of a scan in the scan before it, at all beams and at each half of them; medians over pairs \
                  spread over the drive, starting from nothing, the reference prepared before."
            .into(),
        svg: curves(&panels)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::plan::Case;
    use crate::profile::summary::{ErrorFigures, Figures};

    #[test]
    fn the_median_descent_keeps_matches_that_have_ended() {
        assert_eq!(median_descent(&[vec![5.0, 1.0], vec![6.0, 4.0, 2.0], vec![7.0, 5.0, 3.0]]), [6.0, 4.0, 2.0]);
        assert!(median_descent(&[]).is_empty());
    }

    fn case(variant: &str, value: f64, rmse: f64) -> CaseSummary {
        let position = ErrorFigures { mean_square: rmse * rmse, ..ErrorFigures::default() };
        let case = Case { variant: variant.parse().unwrap(), knob: Knob::Beams, value };
        CaseSummary { case, rounds: 1, figures: Figures { position, ..Figures::default() } }
    }

    #[test]
    fn what_searches_differ_by_is_what_was_measured() {
        let cases = [
            case("projective+point_to_line", 90.0, 0.001),
            case("jump_table+point_to_line", 90.0, 0.010),
            case("jump_table+point_to_line", 180.0, 0.005),
            case("naive+point_to_line", 90.0, 0.012),
            case("naive+point_to_point", 90.0, 0.5),
        ];
        assert!(difference_of_searches(&cases, Knob::Beams).contains("at most 2.000 mm"));
        assert_eq!(difference_of_searches(&cases, Knob::TimeBudget), "");
        assert_eq!(difference_of_searches(&cases[..3], Knob::Beams), "", "nothing to compare");
    }

    #[test]
    fn legends_name_what_there_are_curves_of() {
        let curves: Vec<Variant> =
            ["jump_table+linearized", "particle_filter"].iter().map(|name| name.parse().unwrap()).collect();
        let names = |legend: Vec<Series>| legend.into_iter().map(|series| series.name).collect::<Vec<_>>();
        assert_eq!(names(solver_legend(&curves)), ["linearized"]);
        assert_eq!(names(search_legend(&curves)), ["jump_table"]);
        assert!(solver_legend(&curves[1..]).is_empty() && search_legend(&curves[1..]).is_empty());
    }

    #[test]
    fn no_two_variants_look_the_same() {
        let looks: Vec<Look> = Variant::matchers().into_iter().chain([Variant::Filter]).map(look).collect();
        for (i, one) in looks.iter().enumerate() {
            assert!(looks[i + 1..].iter().all(|other| other != one), "{one:?}");
        }
    }
}
