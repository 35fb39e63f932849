//! The publishers of the node.

use std::sync::Arc;
use std::time::Duration;

use rosrust::api::Ros;

use super::compat::{NodeInterface, PoseOutputs};
use super::convert::Outgoing;
use super::path::PathHistory;
use crate::messages::geometry_msgs::PoseStamped;
use crate::messages::nav_msgs::{Odometry, Path};
use crate::messages::own::MatchReport;
use crate::messages::std_msgs::Int32;
use crate::messages::visualization_msgs::Marker;
use crate::odometry::{MatchedPoints, OdometryCounters, Outcome};
use crate::ros::NodeError;
use crate::ros::output::Output;
use crate::ros::transform_output::TransformOutput;
use crate::time::Stamp;

/// Topic of the pose.
pub(super) const POSE: &str = "scan_match_location";

/// The publishers of all topics that an answer is published on.
pub(super) struct Publishers {
    pose: Output<PoseStamped>,
    state: Output<Int32>,
    odometry: Output<Odometry>,
    report: Output<MatchReport>,
    path: Output<Path>,
    debug: Output<Marker>,
    transform: Arc<TransformOutput>,
    /// The pose topics of `laser_scan_matcher`, in compatibility mode.
    compat: Option<PoseOutputs>,
    edge: i32,
    history: PathHistory,
    last_transform: Option<Stamp>,
}

impl Publishers {
    /// `transform` is shared with the main thread, which can switch transforms on and off.
    pub(super) fn new(ros: &Ros, transform: Arc<TransformOutput>, interface: &NodeInterface) -> Result<Self, NodeError> {
        Ok(Self {
            pose: Output::urgent(ros, POSE)?,
            state: Output::urgent(ros, "icp_state")?,
            odometry: Output::new(ros, "icp/odom")?,
            report: Output::new(ros, "icp_report")?,
            path: Output::latched(ros, "icp/path")?,
            debug: Output::new(ros, "scan_match_debug")?,
            transform,
            compat: interface.poses.map(|wanted| PoseOutputs::new(ros, wanted)).transpose()?,
            edge: 0,
            history: PathHistory::default(),
            last_transform: None,
        })
    }

    /// Whether matched points are subscribed to.
    pub(super) fn wants_matched_points(&self) -> bool {
        self.debug.has_subscribers()
    }

    /// The output of transforms.
    pub(super) fn transform(&self) -> &TransformOutput {
        &self.transform
    }

    /// Publishes what a controller waits for: the pose, and the edge that signals it.
    pub(super) fn publish_pose(&mut self, answer: &Outgoing) {
        self.pose.send(|| answer.pose_stamped());
        if let Some(compat) = &self.compat {
            compat.publish(answer);
        }
        self.edge = 1 - self.edge;
        self.state.send(|| Int32 { data: self.edge });
    }

    /// Publishes everything else. The counters go into the report.
    pub(super) fn publish_details(&mut self, answer: &Outgoing, counters: &OdometryCounters, dropped: u64) {
        self.publish_transform(answer);
        self.odometry.send(|| answer.odometry());
        self.report.send(|| answer.report(counters, dropped));
    }

    /// Publishes the transforms, except for repeated or older stamps: tf rejects a repeated stamp, and an answer to an
    /// out-of-order scan adds nothing.
    fn publish_transform(&mut self, answer: &Outgoing) {
        let (stamp, outcome) = (answer.estimate.stamp, &answer.estimate.registration.outcome);
        if *outcome == Outcome::First || self.last_transform.is_none_or(|last| stamp > last) {
            self.last_transform = Some(stamp);
            self.transform.send(|| answer.transforms());
        }
    }

    /// Publishes what is only displayed.
    pub(super) fn publish_display(&mut self, answer: &Outgoing, matched_points: Option<&MatchedPoints>, now: Duration) {
        let registration = &answer.estimate.registration;
        if registration.outcome == Outcome::First {
            self.history.clear();
        }
        self.history.add(&registration.map_from_base(), || answer.pose_stamped());
        if self.path.has_subscribers()
            && let Some(poses) = self.history.due(now)
        {
            self.path.send(|| Path { header: answer.map_header(), poses });
        }
        for marker in matched_points.into_iter().flat_map(|points| answer.markers(points)) {
            self.debug.send(|| marker);
        }
    }
}
