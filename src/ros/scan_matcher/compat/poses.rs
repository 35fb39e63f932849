//! The topics on which `laser_scan_matcher` publishes its poses.

use rosrust::api::Ros;

use super::parameters::PoseTopics;
use crate::messages::Message;
use crate::messages::geometry_msgs::{Pose2D, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped};
use crate::ros::NodeError;
use crate::ros::output::Output;
use crate::ros::scan_matcher::convert::Outgoing;

/// The publishers of the enabled pose topics.
pub(in crate::ros) struct PoseOutputs {
    planar: Option<Output<Pose2D>>,
    stamped: Option<Output<PoseStamped>>,
    with_covariance: Option<Output<PoseWithCovariance>>,
    with_covariance_stamped: Option<Output<PoseWithCovarianceStamped>>,
}

impl PoseOutputs {
    pub(in crate::ros) fn new(ros: &Ros, wanted: PoseTopics) -> Result<Self, NodeError> {
        Ok(Self {
            planar: output(ros, "pose2D", wanted.pose)?,
            stamped: output(ros, "pose_stamped", wanted.stamped)?,
            with_covariance: output(ros, "pose_with_covariance", wanted.with_covariance)?,
            with_covariance_stamped: output(ros, "pose_with_covariance_stamped", wanted.with_covariance_stamped)?,
        })
    }

    pub(in crate::ros) fn publish(&self, answer: &Outgoing) {
        if let Some(output) = &self.planar {
            let pose = answer.estimate.registration.odom_from_base;
            output.send(|| Pose2D { x: pose.x, y: pose.y, theta: pose.theta });
        }
        if let Some(output) = &self.stamped {
            output.send(|| answer.pose_stamped());
        }
        if let Some(output) = &self.with_covariance {
            output.send(|| answer.odometry().pose);
        }
        if let Some(output) = &self.with_covariance_stamped {
            output.send(|| PoseWithCovarianceStamped { header: answer.odom_header(), pose: answer.odometry().pose });
        }
    }
}

fn output<T: Message>(ros: &Ros, topic: &'static str, wanted: bool) -> Result<Option<Output<T>>, NodeError> {
    if wanted { Output::urgent(ros, topic).map(Some) } else { Ok(None) }
}
