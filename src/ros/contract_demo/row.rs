//! The rows of the CSV file.

use crate::io::csv_file::{Column, microseconds};
use crate::messages::own::MatchReport;
use crate::time::Stamp;

/// A report, and the speed at that time, m/s.
pub(super) struct Row {
    pub(super) report: MatchReport,
    pub(super) speed: f64,
}

impl Row {
    pub(super) const COLUMNS: &[Column<Self>] = &[
        ("stamp", |row| Stamp::from(row.report.header.stamp).to_string()),
        ("speed_m_per_s", |row| format!("{:.4}", row.speed)),
        ("time_budget_us", |row| microseconds(row.report.time_budget)),
        ("elapsed_us", |row| microseconds(row.report.elapsed)),
        ("deadline_met", |row| row.report.deadline_met.to_string()),
        ("overrun_us", |row| microseconds(row.report.overrun)),
        ("iterations", |row| row.report.iterations.to_string()),
        ("rays_used", |row| row.report.rays_used.to_string()),
        ("stop_reason", |row| row.report.stop_reason.clone()),
        ("predicted_translation_error_m", |row| format!("{:.6}", row.report.predicted_translation_error)),
        ("translation_error_m", |row| format!("{:.6}", row.report.translation_error)),
        ("rotation_error_rad", |row| format!("{:.6}", row.report.rotation_error)),
    ];
}
