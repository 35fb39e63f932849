//! Writes a CARMEN log to a bag: `/scan`, `/odom`, and the mount of the laser on `/tf_static`.

use super::{CarmenLog, CarmenOdometry, CarmenScan};
use crate::geometry::Pose2;
use crate::io::bag::{BagError, BagWriter};
use crate::messages::geometry_msgs::{PoseWithCovariance, Twist, TwistWithCovariance, Vector3};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Header;
use crate::simulation::drive::mount_message;
use crate::simulation::lidar::LASER_FRAME;
use crate::simulation::odometer::{BASE_FRAME, ODOM_FRAME};
use crate::time::Stamp;

/// Minimum reading accepted as a distance, m: logs use 0 for "no reading".
const RANGE_MIN: f32 = 0.1;

/// Writes the log to `bag`. The odometry is that of the scan lines, with their stamps: the robot has paired the two itself. If
/// the scan lines have no odometry, that of the `ODOM` lines is used.
pub fn record(log: &CarmenLog, mut bag: BagWriter) -> Result<(), BagError> {
    let odometry = odometry_of(log);
    let (no_return_range, scan_time) = (log.no_return_range(), median_interval(log));
    let mut events: Vec<(Stamp, Event)> = log.scans.iter().map(|scan| (scan.odometry.stamp, Event::Scan(scan))).collect();
    events.extend(odometry.iter().map(|odometry| (odometry.stamp, Event::Odometry(odometry))));
    events.sort_by_key(|(stamp, event)| (*stamp, matches!(event, Event::Scan(_))));
    if let Some((start, _)) = events.first() {
        bag.write_latched("/tf_static", *start, &mount_message(*start, log.mount().laser_in_base()))?;
    }
    for (stamp, event) in &events {
        match event {
            Event::Odometry(odometry) => bag.write("/odom", *stamp, &odometry_message(odometry))?,
            Event::Scan(scan) => bag.write("/scan", *stamp, &scan_message(scan, no_return_range, scan_time))?,
        }
    }
    bag.finish()
}

/// A message to write.
enum Event<'a> {
    Odometry(&'a CarmenOdometry),
    Scan(&'a CarmenScan),
}

/// The odometry to write: that of the scan lines, unless they have none or it never moves while that of the `ODOM` lines does.
fn odometry_of(log: &CarmenLog) -> Vec<CarmenOdometry> {
    let of_scans: Vec<CarmenOdometry> = log.scans.iter().map(|scan| scan.odometry).collect();
    let stands_still =
        |odometry: &[CarmenOdometry]| odometry.windows(2).all(|two| two[0].odom_from_base == two[1].odom_from_base);
    if !log.has_poses() || stands_still(&of_scans) && !stands_still(&log.odometry) { log.odometry.clone() } else { of_scans }
}

/// Median interval between the scans, s.
fn median_interval(log: &CarmenLog) -> f64 {
    let stamp = |scan: &CarmenScan| scan.odometry.stamp;
    let mut intervals: Vec<f64> = log.scans.windows(2).map(|two| stamp(&two[1]).seconds_since(stamp(&two[0]))).collect();
    crate::quantile::quantile(&mut intervals, 0.5, f64::total_cmp).unwrap_or(0.0)
}

#[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
fn scan_message(scan: &CarmenScan, no_return_range: f64, scan_time: f64) -> LaserScan {
    let (angle_min, angle_increment) = (scan.angle_min as f32, scan.angle_increment as f32);
    LaserScan {
        header: Header::new(0, scan.odometry.stamp, LASER_FRAME),
        angle_min,
        angle_max: (scan.angle_min + scan.angle_increment * scan.ranges.len().saturating_sub(1) as f64) as f32,
        angle_increment,
        scan_time: scan_time as f32,
        range_min: RANGE_MIN,
        // Readings equal to this value mean "no return".
        range_max: (scan.no_return_range.unwrap_or(no_return_range) as f32).next_down(),
        ranges: scan.ranges.clone(),
        ..LaserScan::default()
    }
}

fn odometry_message(odometry: &CarmenOdometry) -> Odometry {
    let (speed, yaw_rate) = odometry.velocity.unwrap_or_default();
    let along = |x| Vector3 { x, ..Vector3::default() };
    let twist = Twist { linear: along(speed), angular: Vector3 { z: yaw_rate, ..Vector3::default() } };
    Odometry {
        header: Header::new(0, odometry.stamp, ODOM_FRAME),
        child_frame_id: BASE_FRAME.into(),
        pose: PoseWithCovariance { pose: Pose2::into(odometry.odom_from_base), ..PoseWithCovariance::default() },
        twist: TwistWithCovariance { twist, ..TwistWithCovariance::default() },
    }
}
