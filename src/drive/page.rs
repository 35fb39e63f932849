//! The report: a single self-contained HTML page.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use super::study::{HEADER, Outcome, Study, remarks, row};
use super::{DriveError, pictures};
use crate::output;
use crate::profile::html::{beginning, escaped, table};

/// Maximum number of cases whose driven paths are shown.
const MAX_PATH_PICTURES: usize = 12;

/// Explains the columns of the table.
const EXPLANATION: &str = "mean, RMS, p99.9, max: true distance of the rear axle from the path. A drive ends at the first contact with a wall, \
    or when the car has made no progress for 10 s. pose: RMS position error of the estimated poses at their stamps. late: answers that \
    overran their contract or, without a contract, came after the next scan. age: mean age of the pose when a command takes effect. \
    cpu/lap: processor time of the estimator, without that of other programs.";

impl Study<'_> {
    /// Writes `report.html`, `figures.json` and the plots.
    pub fn write(&self, outcomes: &[Outcome], folder: &Path) -> Result<(), DriveError> {
        let file = |name: &str, bytes: &str| {
            let path = folder.join(name);
            output::write(&path, bytes).map_err(|problem| DriveError::File { path, problem })
        };
        fs::create_dir_all(folder).map_err(|problem| DriveError::File { path: folder.into(), problem })?;
        let mut shown = Vec::new();
        if self.loads.len() > 1 {
            let svg = pictures::speed_against_load(outcomes)?;
            file("speed_against_load.svg", &svg)?;
            shown.push(("Highest speed without a crash, by load".to_owned(), svg));
        }
        for (number, outcome) in (1..).zip(outcomes).take(MAX_PATH_PICTURES) {
            for run in outcome.runs.iter().filter(|run| !run.trace.is_empty()) {
                let svg = pictures::path(self.course, run)?;
                file(&format!("path_{number}_seed_{}.svg", run.seed), &svg)?;
                shown.push((format!("{}, seed {}: {}", outcome.case, run.seed, run.ending.name()), svg));
            }
        }
        file("figures.json", &format!("{:#}\n", self.to_json(outcomes)))?;
        file("report.html", &report(self, outcomes, &shown))
    }
}

/// Renders the page. `pictures` are (title, SVG) pairs.
fn report(study: &Study, outcomes: &[Outcome], pictures: &[(String, String)]) -> String {
    let title = format!("Closed-loop drives in {}", study.course.name);
    let mut page = beginning(&title, &title, &study.command, &study.facts());
    let results = table(&HEADER, outcomes.iter().map(row));
    let _ = write!(page, "<h2>Results</h2>\n{results}");
    for remark in remarks(outcomes) {
        let _ = writeln!(page, "<p>{}</p>", escaped(&remark));
    }
    let _ = writeln!(page, "<p>{EXPLANATION}</p>");
    for (title, svg) in pictures {
        let _ = write!(page, "<h2>{}</h2>\n<figure>\n{svg}</figure>\n", escaped(title));
    }
    page + "</body>\n</html>\n"
}
