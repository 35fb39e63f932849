//! Outputs of the node.

use rosrust::api::Ros;

use super::convert::{Placed, fake_scan, header, particles};
use super::map_server::MapServer;
use crate::app::localizer::{Fix, Localizer};
use crate::app::sensed::Sensed;
use crate::config::FrameKnobs;
use crate::geometry::Pose2;
use crate::messages::geometry_msgs::{PoseArray, PoseStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::FilterReport;
use crate::messages::sensor_msgs::LaserScan;
use crate::ros::NodeError;
use crate::ros::output::Output;
use crate::ros::transform_output::TransformOutput;
use crate::time::Stamp;

/// Where the pose leaves by.
pub(super) const POSE: &str = "pf/pose/odom";

/// Every topic.
pub(super) struct Publishers {
    pose: Output<Odometry>,
    report: Output<FilterReport>,
    particles: Output<PoseArray>,
    inferred_pose: Output<PoseStamped>,
    fake_scan: Output<LaserScan>,
    transform: TransformOutput,
    /// Where the map came from a file: it is there for others as long as this lives.
    _map: Option<MapServer>,
    last_pose: Option<Stamp>,
}

impl Publishers {
    pub(super) fn new(ros: &Ros, frames: &FrameKnobs, map: Option<MapServer>) -> Result<Self, NodeError> {
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

    /// The pose, and the transform that goes with it; without odometry there is no frame to give a place to. `is_fix`: the stamp is a
    /// scan's. A pose between scans moves on with odometry, as does everything below that frame: the transform is the same.
    pub(super) fn publish_pose(&mut self, placed: &Placed, odom_from_base: Option<Pose2>, is_fix: bool) {
        if !is_fix && self.last_pose.is_some_and(|last| placed.stamp <= last) {
            return;
        }
        self.last_pose = Some(placed.stamp);
        self.pose.send(|| placed.odometry());
        self.inferred_pose.send(|| placed.pose_stamped());
        if let (Some(odom_from_base), true) = (odom_from_base, is_fix) {
            self.transform.send(|| [placed.transform(&odom_from_base)]);
        }
    }

    pub(super) fn publish_report(&self, fix: &Fix, dropped: u64, map_frame: &str) {
        self.report.send(|| fix.report(header(fix.stamp, map_frame), dropped));
    }

    /// What people look at.
    pub(super) fn publish_display(&self, localizer: &Localizer, scan: &Sensed, map_from_base: &Pose2) {
        self.particles.send(|| particles(localizer, scan.stamp()));
        self.fake_scan.send(|| fake_scan(localizer, scan, map_from_base));
    }
}
