//! A study: all runs of a plan, and their results.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::ProfileError;
use super::comparison::{Comparison, ComparisonSetup};
use super::cost;
use super::csv_files::{self, RunFiles};
use super::html;
use super::knob::Knob;
use super::look_up::LookUpTable;
use super::pictures;
use super::plan::Plan;
use super::results::{ERROR_DEFINITION, Results, VariantCost, representative_cases};
use super::run::{Run, StudyData, run};
use super::search_time;
use super::summary::{CaseSummary, Figures};
use super::variant::Variant;
use crate::anytime::clock::Clock;
use crate::config::Config;
use crate::io::profile_file::Provenance;
use crate::output;

/// Data and settings of a study.
pub struct Study<'a> {
    /// Bag and ground truth.
    pub input: StudyData<'a>,
    /// Configuration shared by all cases.
    pub config: &'a Config,
    /// The cases.
    pub plan: &'a Plan,
    /// Time limits for the comparison of the look-up table with contracts.
    pub deltas: &'a [Duration],
    /// Creates the clock of a run.
    pub new_clock: &'a dyn Fn() -> Arc<dyn Clock>,
    /// Names of the data, for the report.
    pub names: Names,
}

/// Names of the data in the report of a study.
#[derive(Clone, Debug)]
pub struct Names {
    /// The bag.
    pub bag: String,
    /// Source of the ground truth: file or topic.
    pub truth: String,
    /// The clock.
    pub clock: String,
    /// The command line.
    pub command: String,
}

impl Study<'_> {
    /// Executes all runs and writes all files to `folder`. `on_message` is called for every message read, to show progress.
    pub fn conduct(&self, folder: &Path, mut on_message: impl FnMut()) -> Result<Results, ProfileError> {
        fs::create_dir_all(folder).map_err(|error| ProfileError::write(folder, error))?;
        let mut files = RunFiles::create(folder, self.plan)?;
        let cases = &self.plan.cases;
        let mut first_runs = vec![Run::default(); cases.len()];
        let mut figures = vec![Vec::new(); cases.len()];
        let mut answers = vec![Vec::new(); cases.len()];
        let with_map = representative_cases(cases.iter().map(|case| (case.variant, case.knob))).pop();
        for round in 0..self.plan.rounds {
            for i in self.plan.order(round) {
                let config = cases[i].config(self.config)?;
                let keep_points = round == 0 && Some(i) == with_map;
                let run = run(self.input, cases[i].variant, &config, &(self.new_clock)(), keep_points, &mut on_message)?;
                let of_run = Figures::of(&run);
                files.add(&cases[i], round, &run, &of_run)?;
                figures[i].push(of_run);
                let with_iterations = run.scans.iter().filter(|scan| scan.iterations > 0);
                answers[i].extend(with_iterations.filter_map(|scan| Some((scan.iterations, scan.rays, scan.delay_us?))));
                if round == 0 {
                    first_runs[i] = run;
                }
            }
        }
        files.finish()?;
        let cases = cases.iter().zip(&figures);
        let cases: Vec<_> = cases
            .map(|(&case, rounds)| CaseSummary { case, rounds: self.plan.rounds, figures: Figures::median(rounds) })
            .collect();
        let max_distance = self.config.matching.max_correspondence_distance;
        let clock = (self.new_clock)();
        let costs = costs(&cases, &answers);
        let beams = first_runs.first().map_or(0, |run| run.beams);
        let results = Results {
            comparisons: self.compare(&costs, beams, &mut on_message)?,
            costs,
            search_times: search_time::measure(self.input.bag, &self.input.topics.scan, max_distance, &*clock)?,
            truth: self.input.truth.clone(),
            provenance: self.provenance(&first_runs),
            cases,
            first_runs,
        };
        self.write(folder, &results)?;
        Ok(results)
    }

    /// Total number of runs.
    pub fn runs(&self) -> usize {
        let mut matchers: Vec<Variant> =
            self.plan.cases.iter().map(|case| case.variant).filter(|v| *v != Variant::Filter).collect();
        matchers.dedup();
        self.plan.runs() + 2 * matchers.len() * self.deltas.len() * self.plan.rounds as usize
    }

    /// Compares the look-up table with contracts, for every scan matcher.
    fn compare(
        &self,
        costs: &[VariantCost],
        beams: usize,
        mut on_message: impl FnMut(),
    ) -> Result<Vec<Comparison>, ProfileError> {
        let setup =
            ComparisonSetup { input: self.input, config: self.config, rounds: self.plan.rounds, new_clock: self.new_clock };
        let mut comparisons = Vec::new();
        for cost in costs.iter().filter(|cost| cost.variant != Variant::Filter) {
            let Some(table) = &cost.look_up else { continue };
            for &delta in self.deltas {
                comparisons.push(setup.compare(cost.variant, delta, (table, &cost.levels, beams), &mut on_message)?);
            }
        }
        Ok(comparisons)
    }

    fn provenance(&self, runs: &[Run]) -> Provenance {
        let names = &self.names;
        Provenance {
            version: env!("CARGO_PKG_VERSION").into(),
            bag: names.bag.clone(),
            scan_topic: self.input.topics.scan.clone(),
            odometry_topic: self.input.topics.odometry.clone(),
            truth: names.truth.clone(),
            error: ERROR_DEFINITION.into(),
            scans: runs.first().map_or(0, |run| run.scans.len()),
            beams: runs.first().map_or(0, |run| run.beams),
            rounds: self.plan.rounds,
            seed: self.plan.seed,
            clock: names.clock.clone(),
            parameters: self.config.changes().into_iter().collect(),
        }
    }

    fn write(&self, folder: &Path, results: &Results) -> Result<(), ProfileError> {
        let write = |name: &str, text: &str| {
            let path = folder.join(name);
            output::write(&path, text).map_err(|error| ProfileError::write(&path, error))
        };
        csv_files::write_summary(folder.join("summary.csv"), &results.cases)?;
        let yaml = results.profile().to_yaml();
        write(
            "profile.yaml",
            &yaml.map_err(|error| ProfileError::write(&folder.join("profile.yaml"), std::io::Error::other(error)))?,
        )?;
        let pictures = pictures::draw(results)?;
        for picture in &pictures {
            write(&format!("{}.svg", picture.name), &picture.svg)?;
        }
        write("report.html", &html::report(results, &pictures, &self.names.command))
    }
}

/// Fits the costs of each variant: the cost model to all runs that use every ray, the look-up table to all runs. `answers` holds
/// iterations, rays and delay in us of the answers of each case.
fn costs(cases: &[CaseSummary], answers: &[Vec<(u32, u64, f64)>]) -> Vec<VariantCost> {
    let mut variants: Vec<Variant> = cases.iter().map(|summary| summary.case.variant).collect();
    variants.dedup();
    let of = |variant: Variant, include_beams: bool| {
        let is_wanted =
            move |summary: &CaseSummary| summary.case.variant == variant && (include_beams || summary.case.knob != Knob::Beams);
        cases.iter().zip(answers).filter(move |(summary, _)| is_wanted(summary)).flat_map(|(_, answers)| answers.iter().copied())
    };
    let cost = |variant: Variant| {
        let levels = cost::levels(of(variant, false));
        let look_up = LookUpTable::fit(&of(variant, true).collect::<Vec<_>>());
        VariantCost { variant, model: cost::fit(&levels), look_up, levels }
    };
    variants.into_iter().map(cost).collect()
}
