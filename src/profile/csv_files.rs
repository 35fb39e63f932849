//! The CSV tables of a study. Results of a run are written before the next run begins; tables of an earlier study are replaced
//! when the study is complete.

use std::fs;
use std::path::{Path, PathBuf};

use super::ProfileError;
use super::plan::{Case, Plan};
use super::run::{Run, ScanRecord};
use super::summary::{CaseSummary, Figures};
use super::variant::Variant;
use crate::output::OutputFile;

const CASE_COLUMNS: [&str; 4] = ["variant", "knob", "value", "unit"];
const FIGURE_COLUMNS: [&str; 16] = [
    "scans",
    "failed",
    "mean_delay_us",
    "p50_delay_us",
    "p99_delay_us",
    "position_mse_m2",
    "position_rmse_m",
    "position_mean_m",
    "position_p95_m",
    "orientation_mse_rad2",
    "orientation_rmse_rad",
    "orientation_mean_rad",
    "orientation_p95_rad",
    "drift_per_m_rmse_m",
    "drift_per_m_rmse_rad",
    "mean_iterations",
];
const SCAN_COLUMNS: [&str; 12] = [
    "knob",
    "value",
    "unit",
    "round",
    "stamp",
    "matched",
    "delay_us",
    "iterations",
    "rays",
    "mean_residual_m",
    "position_error_m",
    "orientation_error_rad",
];

/// The tables that grow with every run: `runs.csv`, and `scans/VARIANT.csv` with all scans of a variant.
pub struct RunFiles {
    runs: Table,
    scans: Vec<(Variant, Table)>,
}

impl RunFiles {
    /// Creates the tables of a plan in `folder`.
    pub fn create(folder: &Path, plan: &Plan) -> Result<Self, ProfileError> {
        let scans_folder = folder.join("scans");
        fs::create_dir_all(&scans_folder).map_err(|error| ProfileError::write(&scans_folder, error))?;
        let mut scans: Vec<(Variant, Table)> = Vec::new();
        for case in &plan.cases {
            if scans.iter().all(|(variant, _)| *variant != case.variant) {
                let path = scans_folder.join(format!("{}.csv", case.variant));
                scans.push((case.variant, Table::create(path, &SCAN_COLUMNS)?));
            }
        }
        let runs = Table::create(folder.join("runs.csv"), &[&CASE_COLUMNS[..], &["round"], &FIGURE_COLUMNS].concat())?;
        Ok(Self { runs, scans })
    }

    /// Appends the rows of a run.
    pub fn add(&mut self, case: &Case, round: u32, run: &Run, figures: &Figures) -> Result<(), ProfileError> {
        if let Some((_, table)) = self.scans.iter_mut().find(|(variant, _)| *variant == case.variant) {
            for scan in &run.scans {
                table.write(&scan_row(case, round, scan))?;
            }
            table.flush()?;
        }
        self.runs.write(&row(case, round, figures))?;
        self.runs.flush()
    }

    /// Completes the study: commits all tables, replacing older ones.
    pub fn finish(self) -> Result<(), ProfileError> {
        self.scans.into_iter().map(|(_, table)| table).chain([self.runs]).try_for_each(Table::finish)
    }
}

/// Writes the summary table of a study.
pub fn write_summary(path: PathBuf, cases: &[CaseSummary]) -> Result<(), ProfileError> {
    let mut table = Table::create(path, &[&CASE_COLUMNS[..], &["rounds"], &FIGURE_COLUMNS].concat())?;
    for summary in cases {
        table.write(&row(&summary.case, summary.rounds, &summary.figures))?;
    }
    table.finish()
}

fn scan_row(case: &Case, round: u32, scan: &ScanRecord) -> Vec<String> {
    let or_empty = |value: Option<f64>| value.map_or_else(String::new, |v| v.to_string());
    vec![
        case.knob.name().into(),
        case.value.to_string(),
        case.knob.unit().into(),
        round.to_string(),
        scan.stamp.to_string(),
        scan.matched.to_string(),
        scan.delay_us.map_or_else(String::new, |us| format!("{us:.3}")),
        scan.iterations.to_string(),
        scan.rays.to_string(),
        or_empty(scan.mean_residual),
        or_empty(scan.error.map(|error| error.distance())),
        or_empty(scan.error.map(|error| error.theta.abs())),
    ]
}

fn row(case: &Case, round: u32, figures: &Figures) -> Vec<String> {
    let Figures { scans, failed, delay, position, orientation, drift, mean_iterations } = figures;
    let mut row = vec![case.variant.to_string(), case.knob.name().into(), case.value.to_string(), case.knob.unit().into()];
    row.extend([round.to_string(), scans.to_string(), failed.to_string()]);
    row.extend([delay.mean, delay.p50, delay.p99].map(|us| format!("{us:.3}")));
    for errors in [position, orientation] {
        row.extend([errors.mean_square, errors.rmse(), errors.mean, errors.p95].map(|v| v.to_string()));
    }
    row.extend([drift.0, drift.1, *mean_iterations].map(|v| if v.is_nan() { String::new() } else { v.to_string() }));
    row
}

/// A CSV file whose errors include its path.
struct Table {
    path: PathBuf,
    writer: csv::Writer<OutputFile>,
}

impl Table {
    fn create(path: PathBuf, header: &[&str]) -> Result<Self, ProfileError> {
        let file = OutputFile::create_growing(&path).map_err(|error| ProfileError::write(&path, error))?;
        let mut table = Self { path, writer: csv::Writer::from_writer(file) };
        table.write(header)?;
        Ok(table)
    }

    fn write<T: AsRef<[u8]>>(&mut self, record: &[T]) -> Result<(), ProfileError> {
        self.writer.write_record(record).map_err(|error| ProfileError::write(&self.path, error.into()))
    }

    fn flush(&mut self) -> Result<(), ProfileError> {
        self.writer.flush().map_err(|error| ProfileError::write(&self.path, error))
    }

    fn finish(self) -> Result<(), ProfileError> {
        let file = self.writer.into_inner().map_err(csv::IntoInnerError::into_error);
        file.and_then(|mut file| file.commit()).map_err(|error| ProfileError::write(&self.path, error))
    }
}
