//! The follower's messages.

use rosrust_msg::geometry_msgs::{Point as PointMessage, Vector3};
use rosrust_msg::std_msgs::{ColorRGBA, Header as MarkerHeader};
use rosrust_msg::visualization_msgs::Marker;

use crate::control::follower::Step;
use crate::control::path::{Path, Waypoint};
use crate::geometry::{Point, Pose2};
use crate::messages::ackermann_msgs::{AckermannDrive, AckermannDriveStamped};
use crate::messages::geometry_msgs::PoseStamped;
use crate::messages::nav_msgs;
use crate::messages::own::FollowerReport;
use crate::messages::std_msgs::Header;
use crate::time::Stamp;

/// Distance between the points of a path as it is shown, m.
const SHOWN: f64 = 0.2;

fn header(number: u32, stamp: Stamp, frame: &str) -> Header {
    Header { seq: number, stamp: stamp.into(), frame_id: frame.into() }
}

/// The waypoints of a path's message, in the frame that `pose_from_path` takes them to.
pub(super) fn waypoints(message: &nav_msgs::Path, pose_from_path: &Pose2) -> Vec<Waypoint> {
    let transform = pose_from_path.transform();
    let point = |stamped: &PoseStamped| transform.apply(Point::new(stamped.pose.position.x, stamped.pose.position.y));
    message.poses.iter().map(|pose| Waypoint { point: point(pose), speed: None }).collect()
}

#[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
pub(super) fn drive(number: u32, stamp: Stamp, frame: &str, step: &Step) -> AckermannDriveStamped {
    let drive =
        AckermannDrive { speed: step.command.speed as f32, steering_angle: step.steering as f32, ..AckermannDrive::default() };
    AckermannDriveStamped { header: header(number, stamp, frame), drive }
}

pub(super) fn report(number: u32, stamp: Stamp, frame: &str, step: &Step, path: Option<&Path>) -> FollowerReport {
    let place = step.place;
    FollowerReport {
        header: header(number, stamp, frame),
        driving: step.stop.is_none(),
        reason: step.stop.map_or_else(String::new, |stop| stop.to_string()),
        lateral_error: place.map_or(f64::NAN, |place| place.lateral_error),
        heading_error: place.map_or(f64::NAN, |place| place.heading_error),
        progress: place.map_or(f64::NAN, |place| place.along),
        remaining: place.zip(path).map_or(f64::NAN, |(place, path)| path.remaining(place.along)),
        speed: step.command.speed,
        steering_angle: step.steering,
        lookahead: step.lookahead,
        pose_age: step.pose_age.unwrap_or(f64::NAN),
        path_age: step.path_age.unwrap_or(f64::NAN),
    }
}

/// The path, and the point of it that is one look-ahead away.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
pub(super) fn markers(stamp: Stamp, frame: &str, path: &Path, step: &Step) -> [Marker; 2] {
    let end = if path.is_closed() { path.length() } else { path.length() - 1e-6 };
    let points = (0..=(end / SHOWN) as usize).map(|i| path.point(i as f64 * SHOWN)).chain([path.point(end)]);
    let target = step.place.map(|place| path.point(place.along + step.lookahead));
    [
        marker(stamp, frame, (0, Marker::LINE_STRIP, 0.05), [0.2, 0.8, 0.3], &points.collect::<Vec<_>>()),
        marker(stamp, frame, (1, Marker::POINTS, 0.2), [0.95, 0.3, 0.1], target.as_slice()),
    ]
}

fn marker(stamp: Stamp, frame: &str, (id, kind, size): (i32, u8, f64), [r, g, b]: [f32; 3], points: &[Point]) -> Marker {
    let (sec, nsec) = stamp.to_ros();
    let mut marker = Marker {
        header: MarkerHeader { seq: 0, stamp: rosrust::Time { sec, nsec }, frame_id: frame.into() },
        ns: "follower".into(),
        id,
        type_: i32::from(kind),
        action: i32::from(Marker::ADD),
        scale: Vector3 { x: size, y: size, z: 0.0 },
        color: ColorRGBA { r, g, b, a: 1.0 },
        points: points.iter().map(|p| PointMessage { x: p.x, y: p.y, z: 0.03 }).collect(),
        ..Marker::default()
    };
    marker.pose.orientation.w = 1.0;
    marker
}
