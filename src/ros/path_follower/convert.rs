//! Conversion to and from the messages of the follower.

use crate::control::follower::Step;
use crate::control::path::{Path, Waypoint};
use crate::control::safety::StopReason;
use crate::geometry::{Point, Pose2};
use crate::messages::ackermann_msgs::{AckermannDrive, AckermannDriveStamped};
use crate::messages::geometry_msgs::PoseStamped;
use crate::messages::nav_msgs;
use crate::messages::own::FollowerReport;
use crate::messages::std_msgs::Header;
use crate::messages::visualization_msgs::Marker;
use crate::ros::markers::{self, Style};
use crate::time::Stamp;

/// Distance between the points of a displayed path, m.
const SPACING: f64 = 0.2;

/// The waypoints of a path message, transformed by `pose_from_path` to the frame of the poses.
pub(super) fn waypoints(message: &nav_msgs::Path, pose_from_path: &Pose2) -> Vec<Waypoint> {
    let transform = pose_from_path.transform();
    let point = |stamped: &PoseStamped| transform.apply(Point::new(stamped.pose.position.x, stamped.pose.position.y));
    message.poses.iter().map(|pose| Waypoint { point: point(pose), speed: None }).collect()
}

#[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
pub(super) fn drive(number: u32, stamp: Stamp, frame: &str, step: &Step) -> AckermannDriveStamped {
    let drive =
        AckermannDrive { speed: step.command.speed as f32, steering_angle: step.steering as f32, ..AckermannDrive::default() };
    AckermannDriveStamped { header: Header::new(number, stamp, frame), drive }
}

pub(super) fn report(number: u32, stamp: Stamp, frame: &str, step: &Step, path: Option<&Path>) -> FollowerReport {
    let projection = step.projection;
    FollowerReport {
        header: Header::new(number, stamp, frame),
        driving: step.stop.is_none(),
        stop_reason: step.stop.as_ref().map_or("", StopReason::code).into(),
        reason: step.stop.map_or_else(String::new, |stop| stop.to_string()),
        lateral_error: projection.map_or(f64::NAN, |projection| projection.lateral_error),
        heading_error: projection.map_or(f64::NAN, |projection| projection.heading_error),
        progress: projection.map_or(f64::NAN, |projection| projection.along),
        remaining: projection.zip(path).map_or(f64::NAN, |(projection, path)| path.remaining(projection.along)),
        speed: step.command.speed,
        steering_angle: step.steering,
        lookahead: step.lookahead,
        pose_age: step.pose_age.unwrap_or(f64::NAN),
        path_age: step.path_age.unwrap_or(f64::NAN),
    }
}

/// Markers of the path and of its point at the look-ahead distance.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
pub(super) fn markers(stamp: Stamp, frame: &str, path: &Path, step: &Step) -> [Marker; 2] {
    let end = if path.is_closed() { path.length() } else { path.length() - 1e-6 };
    let points = (0..=(end / SPACING) as usize).map(|i| path.point(i as f64 * SPACING)).chain([path.point(end)]);
    let target = step.projection.map(|projection| path.point(projection.along + step.lookahead));
    let shown = [
        (Style { kind: Marker::LINE_STRIP, width: 0.05, color: [0.2, 0.8, 0.3] }, points.map(|p| markers::point(&p)).collect()),
        (Style { kind: Marker::POINTS, width: 0.2, color: [0.95, 0.3, 0.1] }, target.iter().map(markers::point).collect()),
    ];
    markers::markers(&Header::new(0, stamp, frame), "follower", shown)
}
