//! A row for every report.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::messages::own::MatchReport;
use crate::time::Stamp;

const HEADER: [&str; 12] = [
    "stamp",
    "speed_m_per_s",
    "time_budget_us",
    "elapsed_us",
    "deadline_met",
    "overrun_us",
    "iterations",
    "rays_used",
    "stop_reason",
    "predicted_translation_error_m",
    "translation_error_m",
    "rotation_error_rad",
];

/// A file that is whole after every row.
pub(super) struct CsvFile {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl CsvFile {
    /// Makes the file anew. The error names it.
    pub(super) fn create(path: &Path) -> Result<Self, String> {
        let create = || {
            let mut writer = csv::Writer::from_path(path)?;
            writer.write_record(HEADER)?;
            writer.flush()?;
            Ok(writer)
        };
        let writer = create().map_err(|error: csv::Error| describe(path, &error))?;
        Ok(Self { path: path.into(), writer })
    }

    /// Writes the row of a report that came at `speed`, m/s.
    pub(super) fn write(&mut self, report: &MatchReport, speed: f64) -> Result<(), String> {
        let microseconds = |span: crate::messages::Duration| format!("{:.3}", span.seconds() * 1e6);
        let row = [
            Stamp::from(report.header.stamp).to_string(),
            format!("{speed:.4}"),
            microseconds(report.time_budget),
            microseconds(report.elapsed),
            report.deadline_met.to_string(),
            microseconds(report.overrun),
            report.iterations.to_string(),
            report.rays_used.to_string(),
            report.stop_reason.clone(),
            format!("{:.6}", report.predicted_translation_error),
            format!("{:.6}", report.translation_error),
            format!("{:.6}", report.rotation_error),
        ];
        let written = self.writer.write_record(row).and_then(|()| Ok(self.writer.flush()?));
        written.map_err(|error| describe(&self.path, &error))
    }
}

fn describe(path: &Path, error: &csv::Error) -> String {
    format!("{}: {error}", path.display())
}
