//! The report: a single self-contained HTML page.

use std::fmt::Write as _;

use super::knob::Knob;
use super::pictures::Picture;
use super::results::{ERROR_DEFINITION, Results};
use super::summary::CaseSummary;
use super::tables;

/// Style sheet of the reports.
const STYLE: &str = "
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 1100px; margin: 2rem auto; padding: 0 1rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 3rem; border-bottom: 1px solid #ddd; padding-bottom: .3rem; }
figure { margin: 1rem 0; } svg { width: 100%; height: auto; } figcaption { color: #555; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; display: block; overflow-x: auto; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #eee; white-space: nowrap; }
th:first-child, td:first-child, table.facts td { text-align: left; } table.facts td { white-space: normal; }
pre { background: #f6f7f8; padding: .8rem; overflow-x: auto; } summary { cursor: pointer; font-weight: 600; margin: .6rem 0; }
";

/// Escapes text for HTML content and quoted attributes.
///
/// ```
/// assert_eq!(anytime_scan_matcher::profile::html::escaped("<a & 'b'>"), "&lt;a &amp; &#39;b&#39;&gt;");
/// ```
pub fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            _ => escaped.push(character),
        }
    }
    escaped
}

/// The beginning of a report: head and heading, the command line that produced it, and a table of (name, value).
pub(crate) fn beginning(title: &str, heading: &str, command: &str, facts: &[(&str, String)]) -> String {
    let row = |(name, value): &(&str, String)| format!("<tr><td>{name}</td><td>{}</td></tr>\n", escaped(value));
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>{}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{}</h1>\n<pre>{}</pre>\n<table class=\"facts\">\n{}</table>\n",
        escaped(title),
        escaped(heading),
        escaped(command),
        facts.iter().map(row).collect::<String>()
    )
}

/// Renders the page. `command` is the command line of the study.
pub fn report(results: &Results, pictures: &[Picture], command: &str) -> String {
    let bag = &results.provenance.bag;
    let heading = format!("Delay and error profile of {bag}");
    let mut page = beginning(&format!("Profile of {bag}"), &heading, command, &facts(results));
    let mut add = |text: &str| page.push_str(text);
    add(&contents(pictures));
    for picture in pictures {
        add(&format!(
            "<h2 id=\"{}\">{}</h2>\n<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n",
            escaped(&picture.name),
            escaped(&picture.title),
            picture.svg,
            escaped(&picture.caption)
        ));
    }
    add(&cost_table(results));
    add(&look_up_tables(results));
    add(&summary_tables(results));
    add("</body>\n</html>\n");
    page
}

fn contents(pictures: &[Picture]) -> String {
    let entry = |name: &str, title: &str| format!("<li><a href=\"#{}\">{}</a></li>\n", escaped(name), escaped(title));
    let pictures: String = pictures.iter().map(|picture| entry(&picture.name, &picture.title)).collect();
    let tables = [("cost", "Cost of an iteration"), ("look_up", "Look-up table"), ("summary", "Summary")];
    let tables: String = tables.iter().map(|(name, title)| entry(name, title)).collect();
    format!("<ul>\n{pictures}{tables}</ul>\n")
}

/// What was measured, on which data and how.
fn facts(results: &Results) -> Vec<(&'static str, String)> {
    let from = &results.provenance;
    let parameters: Vec<String> = from.parameters.iter().map(|(path, value)| format!("{path}={value}")).collect();
    let or_none = |text: String| if text.is_empty() { "none".into() } else { text };
    let variants: Vec<String> = results.variants().iter().map(ToString::to_string).collect();
    let knobs: Vec<&str> = results.knobs().iter().map(|knob| knob.name()).collect();
    vec![
        ("bag", from.bag.clone()),
        ("ground truth", from.truth.clone()),
        (
            "topics",
            [Some(from.scan_topic.clone()), from.odometry_topic.clone()].into_iter().flatten().collect::<Vec<_>>().join(", "),
        ),
        ("scans", format!("{} of {} beams", from.scans, from.beams)),
        ("variants", variants.join(", ")),
        ("knobs", knobs.join(", ")),
        ("rounds", format!("{}, each in a different random order (seed {})", from.rounds, from.seed)),
        ("clock", from.clock.clone()),
        ("non-default parameters", or_none(parameters.join(", "))),
        ("version", format!("anytime_scan_matcher {}", from.version)),
        ("errors", ERROR_DEFINITION.into()),
        ("delays", "from the arrival of a scan in the process to its answer; each value is the median over the rounds".into()),
        ("tested values", value_counts(results)),
    ]
}

/// Number of tested values of each knob, and the variants with fewer.
fn value_counts(results: &Results) -> String {
    let of_knob = |knob: Knob| {
        let counts: Vec<_> = results.variants().iter().map(|&variant| (variant, results.cases_of(variant, knob).len())).collect();
        let max_count = counts.iter().map(|(_, count)| *count).max().unwrap_or(0);
        let fewer = counts.iter().filter(|(_, count)| (1..max_count).contains(count));
        let fewer: Vec<String> = fewer.map(|(variant, count)| format!("{variant} {count}")).collect();
        if fewer.is_empty() {
            format!("{}: {max_count}", knob.name())
        } else {
            format!("{}: {max_count} ({})", knob.name(), fewer.join(", "))
        }
    };
    results.knobs().into_iter().map(of_knob).collect::<Vec<_>>().join("; ")
}

/// An HTML table.
pub(crate) fn table<'a>(header: &[&str], rows: impl Iterator<Item = Vec<String>> + 'a) -> String {
    let mut text = String::from("<table>\n<tr>");
    for name in header {
        let _ = write!(text, "<th>{}</th>", escaped(name));
    }
    text.push_str("</tr>\n");
    for row in rows {
        let cells: Vec<String> = row.iter().map(|cell| format!("<td>{}</td>", escaped(cell))).collect();
        let _ = writeln!(text, "<tr>{}</tr>", cells.concat());
    }
    text + "</table>\n"
}

fn cost_table(results: &Results) -> String {
    let rows = results.costs.iter().map(|cost| {
        let figure = |us: Option<f64>| us.map_or_else(|| "-".into(), |us| format!("{us:.1}"));
        let all_rays = results.provenance.beams as f64;
        let costs = cost.model.map(|model| [model.setup_us, 1e3 * model.per_ray_us, all_rays * model.per_ray_us]);
        let figures = (0..3).map(|k| figure(costs.map(|costs| costs[k])));
        [cost.variant.to_string()].into_iter().chain(figures).collect()
    });
    format!(
        "<h2 id=\"cost\">Cost of an iteration</h2>\n{}",
        table(&["variant", "setup [us]", "per ray [ns]", "iteration with all rays [us]"], rows)
    )
}

/// The look-up table and, if requested, its comparison with time contracts.
fn look_up_tables(results: &Results) -> String {
    let look_up = table(&tables::LOOK_UP_HEADER, tables::look_up_rows(results));
    let mut text = format!("<h2 id=\"look_up\">Look-up table</h2>\n<p>{}</p>\n{look_up}", escaped(tables::LOOK_UP_DESCRIPTION));
    if !results.comparisons.is_empty() {
        let comparison = table(&tables::COMPARISON_HEADER, tables::comparison_rows(results));
        let _ = write!(text, "<p>{}</p>\n{comparison}", escaped(tables::COMPARISON_DESCRIPTION));
    }
    text
}

fn summary_tables(results: &Results) -> String {
    let header = [
        "variant",
        "value",
        "failed",
        "mean delay [us]",
        "p50 [us]",
        "p99 [us]",
        "position MSE [mm²]",
        "RMSE [mm]",
        "orientation MSE [deg²]",
        "RMSE [deg]",
        "drift per m [mm]",
        "iterations",
    ];
    let mut text = String::from("<h2 id=\"summary\">Summary</h2>\n");
    for knob in results.knobs() {
        let rows = results.cases.iter().filter(|case| case.case.knob == knob).map(summary_row);
        let _ = writeln!(text, "<details open><summary>{}</summary>\n{}</details>", knob.name(), table(&header, rows));
    }
    text
}

fn summary_row(summary: &CaseSummary) -> Vec<String> {
    let figures = &summary.figures;
    let degrees = figures.orientation.rmse().to_degrees();
    vec![
        summary.case.variant.to_string(),
        summary.case.knob.show(summary.case.value),
        figures.failed.to_string(),
        format!("{:.1}", figures.delay.mean),
        format!("{:.1}", figures.delay.p50),
        format!("{:.1}", figures.delay.p99),
        format!("{:.3}", 1e6 * figures.position.mean_square),
        format!("{:.3}", 1e3 * figures.position.rmse()),
        format!("{:.6}", degrees * degrees),
        format!("{degrees:.4}"),
        format!("{:.3}", 1e3 * figures.drift.0),
        format!("{:.2}", figures.mean_iterations),
    ]
}
