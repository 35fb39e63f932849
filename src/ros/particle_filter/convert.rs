//! Beliefs as ROS messages.

use crate::ros::generated::anytime_scan_matcher::FilterReport;
use crate::ros::generated::geometry_msgs::{PoseArray, PoseStamped, PoseWithCovariance, TransformStamped, TwistWithCovariance};
use crate::ros::generated::nav_msgs::Odometry;
use crate::ros::generated::sensor_msgs::LaserScan as ScanMessage;
use crate::ros::generated::std_msgs::Header;
use nalgebra::Matrix3;

use crate::anytime::ErrorEstimate;
use crate::app::localizer::{Fix, Localizer};
use crate::config::Config;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::localization::filter::Belief;
use crate::messages::sensor_msgs::LaserScan;
use crate::ros::fields::{self, covariance, pose, transform, twist};
use crate::time::Stamp;

/// Particles shown at most: people see no more.
const SHOWN: usize = 1000;

/// Its answers are not numbered.
pub(super) fn header(stamp: Stamp, frame: &str) -> Header {
    fields::header(0, stamp, frame)
}

/// Where the robot is at a time. How sure its velocity is, odometry knows, not the filter.
pub(super) struct Placed<'a> {
    pub(super) stamp: Stamp,
    pub(super) map_from_base: Pose2,
    pub(super) covariance: PoseCovariance,
    pub(super) twist: Twist2,
    pub(super) config: &'a Config,
}

impl Placed<'_> {
    fn header(&self) -> Header {
        header(self.stamp, &self.config.frames.map_frame)
    }

    pub(super) fn odometry(&self) -> Odometry {
        Odometry {
            header: self.header(),
            child_frame_id: self.config.frames.base_frame.clone(),
            pose: PoseWithCovariance { pose: pose(&self.map_from_base), covariance: covariance(&self.covariance) },
            twist: TwistWithCovariance { twist: twist(&self.twist), covariance: covariance(&Matrix3::from_element(f64::NAN)) },
        }
    }

    pub(super) fn pose_stamped(&self) -> PoseStamped {
        PoseStamped { header: self.header(), pose: pose(&self.map_from_base) }
    }

    /// From the map to the frame of the odometry, which has the base at `odom_from_base`.
    pub(super) fn transform(&self, odom_from_base: &Pose2) -> TransformStamped {
        transform(self.header(), &self.config.frames.odom_frame, &(self.map_from_base * odom_from_base.inverse()))
    }
}

/// What there is to say of the scan; numbers of a filter that did not use it are NaN.
pub(super) fn report(fix: &Fix, dropped: u64, frame: &str) -> FilterReport {
    let belief = fix.belief.as_ref();
    let number = |value: fn(&_) -> f64| belief.map_or(f64::NAN, value);
    let count = |value: fn(&_) -> usize| u32::try_from(belief.map_or(0, value)).unwrap_or(u32::MAX);
    FilterReport {
        header: header(fix.stamp, frame),
        ok: belief.is_ok(),
        reason: belief.err().map_or_else(String::new, ToString::to_string),
        stop_reason: fix.stop_reason.map_or("", |reason| reason.name()).into(),
        time_budget: fix.contract.time_budget.unwrap_or_default().into(),
        translation_error_bound: fix.contract.translation_error_bound.unwrap_or_default(),
        rotation_error_bound: fix.contract.rotation_error_bound.unwrap_or_default(),
        elapsed: fix.elapsed.into(),
        deadline_met: fix.overrun().is_zero(),
        overrun: fix.overrun().into(),
        localized: belief.is_ok_and(Belief::is_localized),
        particles: count(|belief| belief.particles),
        effective: number(|belief| belief.effective),
        beams: count(|belief| belief.beams),
        fit: number(|belief| belief.fit),
        share: number(|belief| belief.share),
        translation_error: number(|belief| ErrorEstimate::of_covariance(&belief.covariance).translation),
        rotation_error: number(|belief| ErrorEstimate::of_covariance(&belief.covariance).rotation),
        dropped: u32::try_from(dropped).unwrap_or(u32::MAX),
    }
}

/// Some of the particles, each as likely as any other.
pub(super) fn particles(localizer: &Localizer, stamp: Stamp) -> PoseArray {
    let all = localizer.filter().poses();
    let step = all.len().div_ceil(SHOWN).max(1);
    let poses = all.step_by(step).map(|particle| pose(&particle)).collect();
    PoseArray { header: header(stamp, &localizer.config().frames.map_frame), poses }
}

/// What the laser of `scan` would have seen in the map.
#[allow(clippy::cast_possible_truncation)] // messages carry 32 bits
pub(super) fn fake_scan(localizer: &Localizer, scan: &LaserScan, map_from_base: &Pose2) -> ScanMessage {
    let (mount, _) = localizer.mount();
    let side = if mount.upside_down { -1.0 } else { 1.0 };
    let angle = |ray: usize| side * (f64::from(scan.angle_min) + ray as f64 * f64::from(scan.angle_increment));
    let map_from_laser = *map_from_base * mount.base_from_laser;
    let lengths = localizer.filter().expected_ranges(&map_from_laser, (0..scan.ranges.len()).map(angle));
    ScanMessage {
        header: header(scan.header.stamp.into(), &scan.header.frame_id),
        angle_min: scan.angle_min,
        angle_max: scan.angle_max,
        angle_increment: scan.angle_increment,
        range_min: scan.range_min,
        range_max: scan.range_max,
        ranges: lengths.into_iter().map(|length| length as f32).collect(),
        ..Default::default()
    }
}
