//! One line of CSV per scan.

use std::io::{self, Write};

use super::microseconds;
use crate::app::Estimate;
use crate::odometry::Outcome;

/// Writes estimates as CSV; every line is complete in the file before the next scan is matched.
pub struct CsvFile<W: Write> {
    writer: csv::Writer<W>,
}

const HEADER: [&str; 27] = [
    "stamp",
    "x_m",
    "y_m",
    "theta_rad",
    "outcome",
    "stop_reason",
    "iterations",
    "rays",
    "rays_used",
    "correspondences",
    "inliers",
    "mean_residual_m",
    "condition_number",
    "free_direction_rad",
    "predicted_translation_error_m",
    "predicted_rotation_error_rad",
    "translation_error_m",
    "rotation_error_rad",
    "translation_error_excess_m",
    "rotation_error_excess_rad",
    "new_keyframe",
    "budget_us",
    "elapsed_us",
    "overrun_us",
    "deadline_met",
    "failure",
    "problem",
];

impl<W: Write> CsvFile<W> {
    /// Writes the header.
    pub fn new(sink: W) -> csv::Result<Self> {
        let mut writer = csv::Writer::from_writer(sink);
        writer.write_record(HEADER)?;
        Ok(Self { writer })
    }

    /// Writes the line of one scan.
    pub fn write(&mut self, estimate: &Estimate) -> csv::Result<()> {
        let registration = &estimate.registration;
        let pose = registration.map_from_base();
        let (outcome, failure, problem) = match &registration.outcome {
            Outcome::Matched => ("matched", "", ""),
            Outcome::First => ("first", "", ""),
            Outcome::Predicted(failure) => ("predicted", failure.reason.name(), failure.text.as_str()),
        };
        let of_match = registration.refinement.map_or_else(
            || vec![String::new(); 9],
            |r| {
                vec![
                    r.stop_reason.name().into(),
                    r.iterations.to_string(),
                    r.rays.to_string(),
                    r.rays_used.to_string(),
                    r.correspondences.to_string(),
                    r.inliers.to_string(),
                    format!("{:.6}", r.mean_residual),
                    format!("{:.3}", r.condition_number),
                    r.free_direction.map_or_else(String::new, |direction| format!("{direction:.6}")),
                ]
            },
        );
        let mut record: Vec<String> = vec![
            estimate.stamp.to_string(),
            format!("{:.9}", pose.x),
            format!("{:.9}", pose.y),
            format!("{:.9}", pose.theta),
            outcome.into(),
        ];
        record.extend(of_match);
        for error in [registration.predicted_error, registration.estimated_error, estimate.error_excess()] {
            record.extend([format!("{:.6}", error.translation), format!("{:.6}", error.rotation)]);
        }
        record.extend([
            registration.new_keyframe.to_string(),
            estimate.contract.time_budget.map_or_else(String::new, |budget| format!("{:.3}", microseconds(budget))),
            format!("{:.3}", microseconds(estimate.elapsed)),
            format!("{:.3}", microseconds(estimate.overrun())),
            estimate.deadline_met().to_string(),
            failure.into(),
            problem.into(),
        ]);
        self.writer.write_record(record)?;
        Ok(self.writer.flush()?)
    }

    /// The sink, with all that was written.
    pub fn into_sink(self) -> io::Result<W> {
        self.writer.into_inner().map_err(csv::IntoInnerError::into_error)
    }
}
