//! The publishers of the node.

use rosrust::api::Ros;

use super::convert::{LocalizedPose, fake_scan, header, particles};
use crate::app::localizer::{Fix, Localizer};
use crate::app::sensed::SensorMessage;
use crate::config::FrameKnobs;
use crate::geometry::Pose2;
use crate::messages::geometry_msgs::{PoseArray, PoseStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::FilterReport;
use crate::messages::sensor_msgs::LaserScan;
use crate::ros::NodeError;
use crate::ros::map_output::MapOutput;
use crate::ros::output::Output;
use crate::ros::transform_output::TransformOutput;
use crate::time::Stamp;

/// Topic of the pose.
pub(super) const POSE: &str = "pf/pose/odom";

/// The publishers of all topics.
pub(super) struct Publishers {
    pose: Output<Odometry>,
    report: Output<FilterReport>,
    particles: Output<PoseArray>,
    inferred_pose: Output<PoseStamped>,
    fake_scan: Output<LaserScan>,
    transform: TransformOutput,
    /// Publishes the map if it came from a file.
    _map: Option<MapOutput>,
    last_pose: Option<Stamp>,
}

impl Publishers {
    pub(super) fn new(ros: &Ros, frames: &FrameKnobs, map: Option<MapOutput>) -> Result<Self, NodeError> {
        let transform = TransformOutput::default();
        transform.switch(ros, &frames.odom_frame, frames.publish_tf)?;
        Ok(Self {
            pose: Output::urgent(ros, POSE)?,
            report: Output::new(ros, "pf/report")?,
            particles: Output::new(ros, "pf/viz/particles")?,
            inferred_pose: Output::new(ros, "pf/viz/inferred_pose")?,
            fake_scan: Output::new(ros, "pf/viz/fake_scan")?,
            transform,
            _map: map,
            last_pose: None,
        })
    }

    /// The output of transforms.
    pub(super) fn transform(&self) -> &TransformOutput {
        &self.transform
    }

    /// Publishes the pose and, if there is odometry, the transform to its frame. `is_fix`: the stamp is that of a scan. Between
    /// scans the pose moves with the odometry, so the transform does not change and is not published.
    pub(super) fn publish_pose(&mut self, localized: &LocalizedPose, odom_from_base: Option<Pose2>, is_fix: bool) {
        if !is_fix && self.last_pose.is_some_and(|last| localized.stamp <= last) {
            return;
        }
        self.last_pose = Some(localized.stamp);
        self.pose.send(|| localized.odometry());
        self.inferred_pose.send(|| localized.pose_stamped());
        if let (Some(odom_from_base), true) = (odom_from_base, is_fix) {
            self.transform.send(|| [localized.transform(&odom_from_base)]);
        }
    }

    pub(super) fn publish_report(&self, fix: &Fix, dropped: u64, map_frame: &str) {
        self.report.send(|| fix.report(header(fix.stamp, map_frame), dropped));
    }

    /// Publishes what is only displayed.
    pub(super) fn publish_display(&self, localizer: &Localizer, scan: &SensorMessage, map_from_base: &Pose2) {
        self.particles.send(|| particles(localizer, scan.stamp()));
        self.fake_scan.send(|| fake_scan(localizer, scan, map_from_base));
    }
}
