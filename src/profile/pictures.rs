//! The plots of a study.

use super::ProfileError;
use super::knob::Knob;
use super::results::{Results, VariantCost};
use super::run::Run;
use super::summary::CaseSummary;
use super::variant::Variant;
use crate::evaluation::plot::{Colour, Dash, Marker, Panel, Path, Scale, Series, Style, curves, positions, top_view, true_path};
use crate::geometry::{Point, Pose2, wrap_angle};
use crate::matching::classic::correspondence::CorrespondenceKind;
use crate::matching::solver::SolverKind;
use crate::quantile;

/// Maximum number of trajectories in one plot: more are hard to tell apart.
const MAX_SHOWN_VALUES: usize = 4;

/// A plot with its title and caption.
#[derive(Clone, Debug)]
pub struct Picture {
    /// File name without extension.
    pub name: String,
    /// Title.
    pub title: String,
    /// What the plot shows.
    pub caption: String,
    /// The plot.
    pub svg: String,
}

/// Renders all plots of a study, in the order of the report.
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
    pictures.push(convergence(results)?);
    pictures.push(search_times(results)?);
    Ok(pictures)
}

fn position<T: PartialEq>(all: &[T], one: &T) -> usize {
    all.iter().position(|other| other == one).unwrap_or(0)
}

fn colour(index: usize) -> Colour {
    Colour::CURVES[index % Colour::CURVES.len()]
}

/// Line styles and markers of the searches, in the order of their declaration.
const SEARCH_STYLES: [(Dash, Marker); 6] = [
    (Dash::Dotted, Marker::Triangle),
    (Dash::Solid, Marker::Disc),
    (Dash::Dashed, Marker::Square),
    (Dash::Solid, Marker::Square),
    (Dash::Dashed, Marker::Triangle),
    (Dash::Dotted, Marker::Disc),
];

/// Style of a variant: the colour shows the solver, line style and marker show the search.
fn style(variant: Variant) -> Style {
    let Variant::Matcher { search, solver } = variant else { return filter_style() };
    let (dash, marker) = SEARCH_STYLES[position(CorrespondenceKind::ALL, &search) % SEARCH_STYLES.len()];
    Style { dash, marker, ..Style::line(colour(position(SolverKind::ALL, &solver)), 4) }
}

fn filter_style() -> Style {
    Style { marker: Marker::Disc, ..Style::line(colour(SolverKind::ALL.len()), 7) }
}

/// Legend entries (series without points) for the solvers, by colour.
fn solver_legend(curves: &[Variant]) -> Vec<Series> {
    let is_there = |solver: &&SolverKind| curves.iter().any(|variant| variant.solver() == Some(**solver));
    let entry = |solver: &SolverKind| Series {
        name: solver.name().into(),
        style: Style::line(colour(position(SolverKind::ALL, solver)), 14),
        points: Vec::new(),
    };
    SolverKind::ALL.iter().filter(is_there).map(entry).collect()
}

/// Legend entries (series without points) for the searches, by line style and marker.
fn search_legend(curves: &[Variant]) -> Vec<Series> {
    let is_there = |search: &&CorrespondenceKind| curves.iter().any(|variant| variant.search() == Some(**search));
    let entry = |&search: &CorrespondenceKind| Series {
        name: search.name().into(),
        style: Style { colour: Colour::Ink, ..style(Variant::Matcher { search, solver: SolverKind::PointToLine }) },
        points: Vec::new(),
    };
    CorrespondenceKind::ALL.iter().filter(is_there).map(entry).collect()
}

fn panel(x: &str, y: &str, scales: (Scale, Scale), height: u32, series: Vec<Series>) -> Panel {
    Panel { x: x.into(), y: y.into(), scales, height, series }
}

fn delay_error(results: &Results, knob: Knob) -> Result<Picture, ProfileError> {
    type Error = fn(&CaseSummary) -> f64;
    let mut variants = results.variants();
    variants.retain(|&variant| !results.cases_of(variant, knob).is_empty());
    let curve = |variant: Variant, error: Error| Series {
        name: if variant == Variant::Filter { variant.to_string() } else { String::new() },
        style: style(variant),
        points: results.cases_of(variant, knob).into_iter().map(|case| (case.figures.delay.p50, error(case))).collect(),
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
    values.sort_by(|a, b| knob.sort_key(*a).total_cmp(&knob.sort_key(*b)));
    values.dedup();
    let values: Vec<String> = values.into_iter().map(|value| knob.show(value)).collect();
    Ok(Picture {
        name: format!("delay_error_{}", knob.name()),
        title: format!("Delay and error by {}", knob.name()),
        caption: format!(
            "Each marker is a value of {}: {}. Delay: from the arrival of a scan to its answer, median over all scans, then over the \
             rounds. Error: root mean square after alignment. Colours show the solver; line styles and markers show the search.{}",
            knob.name(),
            values.join(", "),
            search_difference(&results.cases, knob)
        ),
        svg: curves(&panels)?,
    })
}

/// Sentence on how much the errors of the nearest-neighbour searches differ in otherwise equal cases; empty if there are no such
/// cases.
fn search_difference(cases: &[CaseSummary], knob: Knob) -> String {
    let searches_nearest = |case: &&CaseSummary| case.case.variant.search().is_some_and(|search| search.search().is_some());
    let nearest: Vec<_> = cases.iter().filter(|case| case.case.knob == knob).filter(searches_nearest).collect();
    // Values that are displayed the same count as equal.
    let settings = |case: &CaseSummary| (case.case.variant.solver(), knob.show(case.case.value));
    let mut largest: Option<f64> = None;
    for (i, one) in nearest.iter().enumerate() {
        for other in nearest[i + 1..].iter().filter(|other| settings(other) == settings(one)) {
            let difference = (one.figures.position.rmse() - other.figures.position.rmse()).abs();
            largest = Some(largest.map_or(difference, |largest| largest.max(difference)));
        }
    }
    largest.map_or_else(String::new, |difference| {
        format!(
            " With the same solver and value, the position RMSE of the nearest-neighbour searches differs by at most {:.3} mm.",
            1e3 * difference
        )
    })
}

/// The filter's error by the value of a knob, and for comparison the smallest error of a scan matcher in this study.
fn error_by_value(results: &Results, knob: Knob) -> Result<Picture, ProfileError> {
    type Error = fn(&CaseSummary) -> f64;
    let cases = results.cases_of(Variant::Filter, knob);
    let ends = [cases.first(), cases.last()].map(|case| case.map_or(0.0, |case| case.case.value));
    let matchers = || results.cases.iter().filter(|case| case.case.variant != Variant::Filter);
    let best = matchers().min_by(|a, b| a.figures.position.rmse().total_cmp(&b.figures.position.rmse()));
    let of = |label: &str, error: Error| {
        let points = cases.iter().map(|case| (case.case.value, error(case))).collect();
        let mut series = vec![Series { name: Variant::Filter.to_string(), style: filter_style(), points }];
        series.extend(best.map(|best| Series {
            name: best.case.variant.to_string(),
            style: Style { marker: Marker::None, dash: Dash::Dashed, ..style(best.case.variant) },
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
        title: format!("Error of the particle filter by {}", knob.name()),
        caption:
            "Root mean square after alignment, over all scans. For scans that no update used, the pose is the last belief predicted \
                  with odometry. Dashed: the scan matcher with the smallest error in this study, over all knobs."
                .into(),
        svg: curves(&panels)?,
    })
}

/// Indices of the cases to show where a plot cannot show all: evenly chosen from the representative cases, with the first and the
/// last.
fn shown_cases(results: &Results) -> Vec<usize> {
    let all = results.representative_cases();
    let count = all.len().min(MAX_SHOWN_VALUES);
    (0..count).filter_map(|k| all.get(k * (all.len() - 1) / (count - 1).max(1)).copied()).collect()
}

fn case_name(case: &CaseSummary) -> String {
    format!("{} {}", case.case.knob.name(), case.case.knob.show(case.case.value))
}

fn shown_variant_name(results: &Results) -> String {
    shown_cases(results).first().map_or_else(String::new, |&i| results.cases[i].case.variant.to_string())
}

fn trajectories(results: &Results) -> Result<Picture, ProfileError> {
    let chosen = shown_cases(results);
    let mut paths = vec![true_path(&results.truth)];
    for (n, &i) in chosen.iter().enumerate() {
        let run = &results.first_runs[i];
        let points = positions(&run.trajectory()?, &run.truth_from_map);
        let name = format!("{} ({:.1} mm)", case_name(&results.cases[i]), 1e3 * results.cases[i].figures.position.rmse());
        paths.push(Path { name, style: Style::line(path_colour(n), 4), points });
    }
    let scan_points: Vec<Point> = chosen.last().map_or_else(Vec::new, |&i| {
        let run = &results.first_runs[i];
        let transform = run.truth_from_map.transform();
        run.scan_points.iter().map(|&point| transform.apply(point)).collect()
    });
    Ok(Picture {
        name: "trajectories".into(),
        title: "Trajectories on the map".into(),
        caption: format!(
            "{}, each aligned to the ground truth; position RMSE in parentheses. Grey: scan points at the poses of the last trajectory.",
            shown_variant_name(results)
        ),
        svg: top_view(paths, scan_points, "scans")?,
    })
}

/// Colour of the n-th trajectory; orange is reserved for the ground truth.
fn path_colour(n: usize) -> Colour {
    [Colour::Vermilion, Colour::Purple, Colour::Green, Colour::Blue][n % MAX_SHOWN_VALUES]
}

/// The trajectory of a run as (seconds since the first scan, aligned pose, true pose).
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
    style: Style,
    /// Time, s, and the quantities at that time.
    points: Vec<(f64, [f64; 3])>,
}

/// One panel per quantity.
fn pose_panels(labels: [&str; 3], curves: &[PoseCurve]) -> Vec<Panel> {
    let series = |k: usize| {
        let of = |curve: &PoseCurve| Series {
            name: curve.name.clone(),
            style: curve.style,
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
    for (n, &i) in shown_cases(results).iter().enumerate() {
        let poses = aligned(results, &results.first_runs[i]);
        if n == 0 {
            let truth = poses.iter().map(|(t, _, truth)| (*t, *truth)).collect();
            all.push(PoseCurve { name: "truth".into(), style: Style::line(Colour::Orange, 8), points: unwrapped(truth) });
        }
        let estimate = poses.iter().map(|(t, pose, _)| (*t, *pose)).collect();
        let (name, style) = (case_name(&results.cases[i]), Style::line(path_colour(n), 3));
        all.push(PoseCurve { name, style, points: unwrapped(estimate) });
    }
    Ok(Picture {
        name: "poses".into(),
        title: "Poses over time".into(),
        caption: format!("{} and the ground truth, aligned. Headings are unwrapped.", shown_variant_name(results)),
        svg: curves(&pose_panels(["x [m]", "y [m]", "theta [deg]"], &all))?,
    })
}

fn pose_errors(results: &Results) -> Result<Picture, ProfileError> {
    let chosen = shown_cases(results);
    let all = chosen.iter().enumerate().map(|(n, &i)| {
        let error = |(t, pose, truth): (f64, Pose2, Pose2)| {
            (t, [1e3 * (pose.x - truth.x), 1e3 * (pose.y - truth.y), wrap_angle(pose.theta - truth.theta).to_degrees()])
        };
        let points = aligned(results, &results.first_runs[i]).into_iter().map(error).collect();
        PoseCurve { name: case_name(&results.cases[i]), style: Style::line(path_colour(n), 3), points }
    });
    let all: Vec<_> = all.collect();
    Ok(Picture {
        name: "pose_errors".into(),
        title: "Pose errors over time".into(),
        caption: "Difference between the same poses and the ground truth, in the frame of the ground truth.".into(),
        svg: curves(&pose_panels(["x error [mm]", "y error [mm]", "theta error [deg]"], &all))?,
    })
}

fn delay_by_iterations(results: &Results) -> Result<Picture, ProfileError> {
    let of_search = |&search: &CorrespondenceKind| {
        let has_points = |cost: &&VariantCost| cost.variant.search() == Some(search) && !cost.levels.is_empty();
        let costs: Vec<_> = results.costs.iter().filter(has_points).collect();
        if costs.is_empty() {
            return None;
        }
        let variants: Vec<Variant> = costs.iter().map(|cost| cost.variant).collect();
        let series = costs.into_iter().flat_map(|cost| {
            let style = style(cost.variant);
            let points = cost.levels.iter().map(|level| (f64::from(level.iterations), 1e-3 * level.delay_us)).collect();
            let line = cost.model.map(|model| {
                let at_levels = cost.levels.iter().map(|level| (f64::from(level.iterations), 1e-3 * model.delay_us(level.rays)));
                [(0.0, 1e-3 * model.setup_us)].into_iter().chain(at_levels).collect()
            });
            [
                Series { name: String::new(), style: Style { marker: Marker::None, ..style }, points: line.unwrap_or_default() },
                Series { name: String::new(), style: Style { dash: Dash::None, marker_radius: 11, ..style }, points },
            ]
        });
        let series = solver_legend(&variants).into_iter().chain(series).collect();
        let label = format!("{} [ms]", search.name());
        Some(panel("iterations", &label, (Scale::FromZero, Scale::FromZero), 320, series))
    };
    let panels: Vec<Panel> = CorrespondenceKind::ALL.iter().filter_map(of_search).collect();
    Ok(Picture {
        name: "delay_by_iterations".into(),
        title: "Delay by iterations, and the fitted cost model".into(),
        caption: "Markers: median delay of all answers with that number of iterations. Lines: fitted cost model, a setup cost plus a cost per \
                  ray and iteration (the first iterations use few rays). The fit is a weighted median of slopes, which is robust against \
                  preempted answers."
            .into(),
        svg: curves(&panels)?,
    })
}

/// Convergence: each sampled match as a thin line, and their median. A match that has ended keeps its last value.
fn convergence(results: &Results) -> Result<Picture, ProfileError> {
    let search = results.representative_cases().first().map(|&i| results.cases[i].case.variant.search());
    let of_solver = |solver: &SolverKind| {
        let of_solver = results
            .cases
            .iter()
            .zip(&results.first_runs)
            .filter(|(case, _)| Some(case.case.variant.search()) == search && case.case.variant.solver() == Some(*solver));
        // Of all runs with this solver, the one whose matches made the most iterations.
        let run = of_solver.map(|(_, run)| run).max_by_key(|run| run.convergence.iter().map(Vec::len).sum::<usize>())?;
        if run.convergence.is_empty() {
            return None;
        }
        let in_mm =
            |residuals: &[f64]| -> Vec<(f64, f64)> { (1..).map(f64::from).zip(residuals.iter().map(|r| 1e3 * r)).collect() };
        let thin = Style { opacity: 0.6, ..Style::line(Colour::Grey, 2) };
        let mut series: Vec<Series> = run
            .convergence
            .iter()
            .map(|residuals| Series { name: "a match".into(), style: thin, points: in_mm(residuals) })
            .collect();
        let style = Style { marker: Marker::Disc, ..Style::line(colour(position(SolverKind::ALL, solver)), 5) };
        series.push(Series {
            name: format!("median, {}", solver.name()),
            style,
            points: in_mm(&median_convergence(&run.convergence)),
        });
        Some(panel("iteration", "mean residual [mm]", (Scale::Linear, Scale::Logarithmic), 320, series))
    };
    let panels: Vec<Panel> = SolverKind::ALL.iter().filter_map(of_solver).collect();
    Ok(Picture {
        name: "residual_by_iteration".into(),
        title: "Residual by iteration".into(),
        caption: "Mean absolute residual of the inliers before each iteration. Thin lines: matches sampled over the whole drive. Thick line: \
                  their median, where a match that has ended keeps its last value."
            .into(),
        svg: curves(&panels)?,
    })
}

fn median_convergence(convergence: &[Vec<f64>]) -> Vec<f64> {
    let longest = convergence.iter().map(Vec::len).max().unwrap_or(0);
    let at = |i: usize| {
        let mut values: Vec<f64> =
            convergence.iter().filter_map(|residuals| residuals.get(i).or(residuals.last()).copied()).collect();
        values.sort_by(f64::total_cmp);
        quantile::of_sorted(&values, 0.5)
    };
    (0..longest).filter_map(at).collect()
}

fn search_times(results: &Results) -> Result<Picture, ProfileError> {
    let of_search = |&search: &CorrespondenceKind| {
        let times = results.search_times.iter().filter(|time| time.search == search);
        let style = style(Variant::Matcher { search, solver: SolverKind::PointToLine });
        Series {
            name: search.name().into(),
            style: Style { colour: colour(position(CorrespondenceKind::ALL, &search)), ..style },
            points: times.map(|time| (time.beams as f64, time.time_us)).collect(),
        }
    };
    let series = CorrespondenceKind::ALL.iter().map(of_search).filter(|series| !series.points.is_empty()).collect();
    let panels = [panel("beams", "time of a search [us]", (Scale::Logarithmic, Scale::Logarithmic), 640, series)];
    Ok(Picture {
        name: "search_time".into(),
        title: "Time of the nearest-neighbour searches".into(),
        caption: "Time to find the nearest neighbours of all points of a scan in the previous scan, with all beams and with each halving of \
                  their number. Medians over scan pairs spread over the drive; without initial correspondences, and without the time to \
                  prepare the reference."
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
    fn the_median_keeps_the_last_value_of_ended_matches() {
        assert_eq!(median_convergence(&[vec![5.0, 1.0], vec![6.0, 4.0, 2.0], vec![7.0, 5.0, 3.0]]), [6.0, 4.0, 2.0]);
        assert!(median_convergence(&[]).is_empty());
    }

    fn case(variant: &str, value: f64, rmse: f64) -> CaseSummary {
        let position = ErrorFigures { mean_square: rmse * rmse, ..ErrorFigures::default() };
        let case = Case { variant: variant.parse().unwrap(), knob: Knob::Beams, value };
        CaseSummary { case, rounds: 1, figures: Figures { position, ..Figures::default() } }
    }

    #[test]
    fn the_difference_of_searches_is_that_of_equal_cases() {
        let cases = [
            case("projective+point_to_line", 90.0, 0.001),
            case("jump_table+point_to_line", 90.0, 0.010),
            case("jump_table+point_to_line", 180.0, 0.005),
            case("naive+point_to_line", 90.0, 0.012),
            case("naive+point_to_point", 90.0, 0.5),
        ];
        assert!(search_difference(&cases, Knob::Beams).contains("at most 2.000 mm"));
        assert_eq!(search_difference(&cases, Knob::TimeBudget), "");
        assert_eq!(search_difference(&cases[..3], Knob::Beams), "", "nothing to compare");
    }

    #[test]
    fn legends_name_only_shown_curves() {
        let curves: Vec<Variant> =
            ["jump_table+linearized", "particle_filter"].iter().map(|name| name.parse().unwrap()).collect();
        let names = |legend: Vec<Series>| legend.into_iter().map(|series| series.name).collect::<Vec<_>>();
        assert_eq!(names(solver_legend(&curves)), ["linearized"]);
        assert_eq!(names(search_legend(&curves)), ["jump_table"]);
        assert!(solver_legend(&curves[1..]).is_empty() && search_legend(&curves[1..]).is_empty());
    }

    #[test]
    fn no_two_variants_look_the_same() {
        let styles: Vec<Style> = Variant::matchers().into_iter().chain([Variant::Filter]).map(style).collect();
        for (i, one) in styles.iter().enumerate() {
            assert!(styles[i + 1..].iter().all(|other| other != one), "{one:?}");
        }
    }
}
