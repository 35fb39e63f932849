//! Conversion of estimates to ROS messages.

use crate::app::localizer::Localizer;
use crate::app::sensed::SensorMessage;
use crate::cloud;
use crate::config::Config;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::messages::geometry_msgs::{PoseArray, PoseStamped, PoseWithCovariance, TransformStamped, TwistWithCovariance};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Header;
use crate::ros::convert::{covariance, transform};
use crate::time::Stamp;

/// Maximum number of published particles, which are only for display.
const MAX_SHOWN: usize = 1000;

/// A header without a sequence number.
pub(super) fn header(stamp: Stamp, frame: &str) -> Header {
    Header::new(0, stamp, frame)
}

/// The pose of the robot at a time. The covariance of the velocity is unknown to the filter.
pub(super) struct LocalizedPose<'a> {
    pub(super) stamp: Stamp,
    pub(super) map_from_base: Pose2,
    pub(super) covariance: PoseCovariance,
    pub(super) twist: Twist2,
    pub(super) config: &'a Config,
}

impl LocalizedPose<'_> {
    fn header(&self) -> Header {
        header(self.stamp, &self.config.frames.map_frame)
    }

    pub(super) fn odometry(&self) -> Odometry {
        Odometry {
            header: self.header(),
            child_frame_id: self.config.frames.base_frame.clone(),
            pose: PoseWithCovariance { pose: self.map_from_base.into(), covariance: covariance(&self.covariance) },
            twist: TwistWithCovariance {
                twist: self.twist.into(),
                covariance: covariance(&PoseCovariance::from_element(f64::NAN)),
            },
        }
    }

    pub(super) fn pose_stamped(&self) -> PoseStamped {
        PoseStamped { header: self.header(), pose: self.map_from_base.into() }
    }

    /// The transform from the map to the odometry frame; `odom_from_base` is the pose of the base in the latter.
    pub(super) fn transform(&self, odom_from_base: &Pose2) -> TransformStamped {
        transform(self.header(), &self.config.frames.odom_frame, self.map_from_base * odom_from_base.inverse())
    }
}

/// A sample of the particles, which all have the same weight.
pub(super) fn particles(localizer: &Localizer, stamp: Stamp) -> PoseArray {
    let all = localizer.filter().poses();
    let step = all.len().div_ceil(MAX_SHOWN).max(1);
    let poses = all.step_by(step).map(Into::into).collect();
    PoseArray { header: header(stamp, &localizer.config().frames.map_frame), poses }
}

/// The scan that the laser of `sensed` should see on the map. For a point cloud it covers the full circle.
pub(super) fn fake_scan(localizer: &Localizer, sensed: &SensorMessage, map_from_base: &Pose2) -> LaserScan {
    match sensed {
        SensorMessage::Scan(scan) => expected_scan(localizer, scan, map_from_base),
        SensorMessage::Cloud(cloud) => {
            let knobs = &localizer.config().cloud;
            expected_scan(localizer, &cloud::empty_scan(cloud, knobs), map_from_base)
        }
    }
}

#[allow(clippy::cast_possible_truncation)] // messages carry 32 bits
fn expected_scan(localizer: &Localizer, scan: &LaserScan, map_from_base: &Pose2) -> LaserScan {
    let (mount, _) = localizer.mount();
    let side = if mount.upside_down { -1.0 } else { 1.0 };
    let angle = |ray: usize| side * (f64::from(scan.angle_min) + ray as f64 * f64::from(scan.angle_increment));
    let map_from_laser = *map_from_base * mount.base_from_laser;
    let lengths = localizer.filter().expected_ranges(&map_from_laser, (0..scan.ranges.len()).map(angle));
    LaserScan {
        header: header(scan.header.stamp.into(), &scan.header.frame_id),
        angle_min: scan.angle_min,
        angle_max: scan.angle_max,
        angle_increment: scan.angle_increment,
        range_min: scan.range_min,
        range_max: scan.range_max,
        ranges: lengths.into_iter().map(|length| length as f32).collect(),
        ..LaserScan::default()
    }
}
