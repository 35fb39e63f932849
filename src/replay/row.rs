//! Pose and report of each answer, from which CSV rows and the summary are made.

use crate::app::localizer::Fix;
use crate::app::{App, Estimate};
use crate::evaluation::consistency::UncertainPose;
use crate::evaluation::trajectory::StampedPose;
use crate::geometry::{Pose2, PoseCovariance};
use crate::io::csv_file::{Column, microseconds};
use crate::messages::Duration;
use crate::messages::own::{FilterReport, MatchReport};
use crate::messages::std_msgs::Header;
use crate::time::Stamp;

/// The answer of the scan matcher to a scan.
#[derive(Clone, Debug)]
pub struct MatchRow {
    /// Pose of the base in the map frame.
    pub pose: Pose2,
    /// Report of the match, as the node publishes it: its header has the odom frame.
    pub report: MatchReport,
    /// Pose of the base in the odom frame, with its covariance.
    pub uncertain_pose: UncertainPose,
}

impl MatchRow {
    /// The row of the answer that `app` has just given.
    pub fn new(estimate: &Estimate, app: &App) -> Self {
        let header = Header::new(0, estimate.stamp, &app.config().frames.odom_frame);
        let registration = &estimate.registration;
        let uncertain_pose = UncertainPose {
            pose: StampedPose { stamp: estimate.stamp, pose: registration.odom_from_base },
            covariance: registration.covariance,
            is_ok: registration.outcome.is_ok(),
        };
        Self { pose: registration.map_from_base(), report: estimate.report(header, app.odometry_counters(), 0), uncertain_pose }
    }

    /// The columns of the CSV file. Columns about the match are empty if there was none.
    pub const COLUMNS: &[Column<Self>] = &[
        ("stamp", |row| Stamp::from(row.report.header.stamp).to_string()),
        ("x_m", |row| format!("{:.9}", row.pose.x)),
        ("y_m", |row| format!("{:.9}", row.pose.y)),
        ("theta_rad", |row| format!("{:.9}", row.pose.theta)),
        ("outcome", |row| row.outcome().into()),
        ("stop_reason", |row| row.report.stop_reason.clone()),
        ("iterations", |row| row.of_match(|report| report.iterations.to_string())),
        ("rays", |row| row.of_match(|report| report.rays.to_string())),
        ("rays_used", |row| row.of_match(|report| report.rays_used.to_string())),
        ("correspondences", |row| row.of_match(|report| report.correspondences.to_string())),
        ("inliers", |row| row.of_match(|report| report.inliers.to_string())),
        ("mean_residual_m", |row| row.of_match(|report| format!("{:.6}", report.mean_residual))),
        ("condition_number", |row| row.of_match(|report| format!("{:.3}", report.condition_number))),
        ("free_direction_rad", |row| match row.report.free_direction {
            direction if direction.is_nan() => String::new(),
            direction => format!("{direction:.6}"),
        }),
        ("predicted_translation_error_m", |row| format!("{:.6}", row.report.predicted_translation_error)),
        ("predicted_rotation_error_rad", |row| format!("{:.6}", row.report.predicted_rotation_error)),
        ("translation_error_m", |row| format!("{:.6}", row.report.translation_error)),
        ("rotation_error_rad", |row| format!("{:.6}", row.report.rotation_error)),
        ("translation_error_excess_m", |row| format!("{:.6}", row.report.translation_error_excess)),
        ("rotation_error_excess_rad", |row| format!("{:.6}", row.report.rotation_error_excess)),
        ("new_keyframe", |row| row.report.new_keyframe.to_string()),
        ("budget_us", |row| match row.report.time_budget {
            Duration { sec: 0, nsec: 0 } => String::new(),
            budget => microseconds(budget),
        }),
        ("elapsed_us", |row| microseconds(row.report.elapsed)),
        ("overrun_us", |row| microseconds(row.report.overrun)),
        ("deadline_met", |row| row.report.deadline_met.to_string()),
        ("failure", |row| row.report.failure.clone()),
        ("problem", |row| row.report.reason.clone()),
    ];

    fn outcome(&self) -> &'static str {
        match self.report.outcome {
            MatchReport::MATCHED => "matched",
            MatchReport::FIRST => "first",
            _ => "predicted",
        }
    }

    fn of_match(&self, text: fn(&MatchReport) -> String) -> String {
        if self.report.stop_reason.is_empty() { String::new() } else { text(&self.report) }
    }
}

/// The answer of the particle filter to a scan.
#[derive(Clone, Debug)]
pub struct BeliefRow {
    /// Pose of the base in the map frame; `None` if the scan could not be used.
    pub pose: Option<Pose2>,
    /// Covariance of that pose.
    pub covariance: PoseCovariance,
    /// Report of the filter.
    pub report: FilterReport,
}

impl BeliefRow {
    /// The row of an answer; `map_frame` is the name of the map frame.
    pub fn new(fix: &Fix, map_frame: &str) -> Self {
        let belief = fix.belief.as_ref().ok();
        Self {
            pose: belief.map(|belief| belief.map_from_base),
            covariance: belief.map_or_else(PoseCovariance::zeros, |belief| belief.covariance),
            report: fix.report(Header::new(0, fix.stamp, map_frame), 0),
        }
    }

    /// The columns of the CSV file.
    pub const COLUMNS: &[Column<Self>] = &[
        ("stamp", |row| Stamp::from(row.report.header.stamp).to_string()),
        ("x_m", |row| row.coordinate(|pose| pose.x)),
        ("y_m", |row| row.coordinate(|pose| pose.y)),
        ("theta_rad", |row| row.coordinate(|pose| pose.theta)),
        ("sigma_x_m", |row| row.sigma(0)),
        ("sigma_y_m", |row| row.sigma(1)),
        ("sigma_theta_rad", |row| row.sigma(2)),
        ("localized", |row| row.report.localized.to_string()),
        ("share", |row| format!("{:.4}", row.report.share)),
        ("particles", |row| row.report.particles.to_string()),
        ("effective", |row| format!("{:.1}", row.report.effective)),
        ("beams", |row| row.report.beams.to_string()),
        ("fit", |row| format!("{:.5}", row.report.fit)),
        ("explained", |row| format!("{:.4}", row.report.explained)),
        ("stop_reason", |row| row.report.stop_reason.clone()),
        ("elapsed_us", |row| microseconds(row.report.elapsed)),
    ];

    fn sigma(&self, i: usize) -> String {
        format!("{:.6}", self.covariance[(i, i)].max(0.0).sqrt())
    }

    fn coordinate(&self, coordinate: fn(&Pose2) -> f64) -> String {
        self.pose.as_ref().map_or_else(String::new, |pose| format!("{:.9}", coordinate(pose)))
    }
}
