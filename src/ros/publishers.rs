//! What the node says.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use rosrust::api::Ros;
use rosrust::{Message, Publisher, RawMessage, RawMessageDescription};
use rosrust_msg::anytime_scan_matcher::MatchReport;
use rosrust_msg::geometry_msgs::PoseStamped;
use rosrust_msg::nav_msgs::{Odometry, Path};
use rosrust_msg::std_msgs::Int32;
use rosrust_msg::visualization_msgs::Marker;

use super::NodeError;
use super::compat::{Face, PoseOutputs};
use super::convert::Answer;
use super::master::{Role, resolved};
use super::node_api;
use super::path::PathHistory;
use super::priority::urgently;
use super::transform_output::TransformOutput;
use crate::odometry::{MatchedPoints, OdometryCounters, Outcome};
use crate::time::Stamp;

/// Messages that may wait for a subscriber: a bag played fast makes bursts of answers, and of `icp_state` every edge counts.
const QUEUE: usize = 100;

/// A publisher that `rosnode info` tells of for as long as it lives.
pub(super) fn listed<T: Message>(topic: String, publisher: Publisher<T>) -> Arc<Publisher<T>> {
    let publisher = Arc::new(publisher);
    let weak = Arc::downgrade(&publisher);
    node_api::add_output(topic, move || Some(weak.upgrade()?.subscriber_names()));
    publisher
}

/// A topic that messages of one type leave by.
///
/// rosrust writes the present time over stamps of zero and its own numbers over ours, so it is given bytes.
pub(super) struct Output<T> {
    topic: &'static str,
    resolved: String,
    message_type: String,
    publisher: Arc<Publisher<RawMessage>>,
    message: PhantomData<fn(T)>,
}

impl<T> Output<T> {
    /// A topic of messages of this description.
    pub(super) fn described(ros: &Ros, topic: &'static str, description: RawMessageDescription) -> Result<Self, NodeError> {
        let message_type = description.msg_type.clone();
        let publisher = ros
            .publish_with_description(topic, QUEUE, description)
            .map_err(|error| NodeError::ros(format!("publish '{topic}'"), &error))?;
        let resolved = resolved(ros, topic)?;
        let publisher = listed(resolved.clone(), publisher);
        Ok(Self { topic, resolved, message_type, publisher, message: PhantomData })
    }

    /// New listeners are given the last message at once.
    pub(super) fn latched(self) -> Self {
        let mut publisher = Publisher::clone(&self.publisher);
        publisher.set_latching(true);
        Self { publisher: listed(self.resolved.clone(), publisher), ..self }
    }

    pub(super) fn has_listeners(&self) -> bool {
        self.publisher.subscriber_count() > 0
    }

    /// Hands the wire form of a message over, if anybody listens; what it takes to make it is spent only then.
    pub(super) fn send_bytes(&self, bytes: impl FnOnce() -> Vec<u8>) {
        if self.has_listeners() {
            self.keep_bytes(bytes());
        }
    }

    /// Hands the wire form of a message over, even if nobody listens yet.
    pub(super) fn keep_bytes(&self, bytes: Vec<u8>) {
        let _ = self.publisher.send(RawMessage(bytes)); // only queues
    }

    pub(super) fn role(&self) -> Role {
        Role::Publisher { topic: self.topic, message_type: self.message_type.clone() }
    }
}

impl<T: Message> Output<T> {
    pub(super) fn new(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        Self::described(ros, topic, RawMessageDescription::from_message::<T>())
    }

    /// A topic of what a controller waits for: the thread that writes its messages goes before all programs of normal priority.
    pub(super) fn urgent(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        urgently(|| Self::new(ros, topic))
    }

    /// Hands a message over, as [`Self::send_bytes`] does.
    pub(super) fn send(&self, message: impl FnOnce() -> T) {
        self.send_bytes(|| {
            let mut bytes = Vec::new();
            let _ = message().encode(&mut bytes); // cannot fail: it writes to memory
            bytes
        });
    }
}

/// Every topic that an answer leaves by.
pub(super) struct Publishers {
    pose: Output<PoseStamped>,
    state: Output<Int32>,
    odometry: Output<Odometry>,
    report: Output<MatchReport>,
    path: Output<Path>,
    debug: Output<Marker>,
    transform: Arc<TransformOutput>,
    /// The topics of another node's face, if this one has it.
    compat: Option<PoseOutputs>,
    edge: i32,
    history: PathHistory,
    last_transform: Option<Stamp>,
}

impl Publishers {
    /// With the output of transforms, which comes and goes.
    pub(super) fn new(ros: &Ros, transform: Arc<TransformOutput>, face: &Face) -> Result<Self, NodeError> {
        Ok(Self {
            pose: Output::urgent(ros, "scan_match_location")?,
            state: Output::urgent(ros, "icp_state")?,
            odometry: Output::new(ros, "icp/odom")?,
            report: Output::new(ros, "icp_report")?,
            path: Output::new(ros, "icp/path")?.latched(),
            debug: Output::new(ros, "scan_match_debug")?,
            transform,
            compat: face.poses.map(|wanted| PoseOutputs::new(ros, wanted)).transpose()?,
            edge: 0,
            history: PathHistory::default(),
            last_transform: None,
        })
    }

    /// How the topics stand in the master's books.
    pub(super) fn roles(&self) -> Vec<Role> {
        let always =
            [self.pose.role(), self.state.role(), self.odometry.role(), self.report.role(), self.path.role(), self.debug.role()];
        always.into_iter().chain(self.transform.role()).chain(self.compat.iter().flat_map(PoseOutputs::roles)).collect()
    }

    /// Whether anybody looks at matched points.
    pub(super) fn wants_matched_points(&self) -> bool {
        self.debug.has_listeners()
    }

    /// The output of transforms.
    pub(super) fn transform(&self) -> &TransformOutput {
        &self.transform
    }

    /// What the controller waits for: the pose, and the edge that says it is there.
    pub(super) fn publish_pose(&mut self, answer: &Answer) {
        self.pose.send(|| answer.pose_stamped());
        if let Some(compat) = &self.compat {
            compat.publish(answer);
        }
        self.edge = 1 - self.edge;
        self.state.send(|| Int32 { data: self.edge });
    }

    /// Everything else. The counts go into the report.
    pub(super) fn publish_details(&mut self, answer: &Answer, counters: &OdometryCounters, dropped: u64) {
        self.publish_transform(answer);
        self.odometry.send(|| answer.odometry());
        self.report.send(|| answer.report(counters, dropped));
    }

    /// tf does not want a stamp twice, and a transform of the past would only say what an answer out of order repeats.
    fn publish_transform(&mut self, answer: &Answer) {
        let (stamp, outcome) = (answer.estimate.stamp, &answer.estimate.registration.outcome);
        if *outcome == Outcome::First || self.last_transform.is_none_or(|last| stamp > last) {
            self.last_transform = Some(stamp);
            self.transform.send(|| answer.transforms());
        }
    }

    /// What people look at.
    pub(super) fn publish_display(&mut self, answer: &Answer, matched_points: Option<&MatchedPoints>, now: Duration) {
        let registration = &answer.estimate.registration;
        if registration.outcome == Outcome::First {
            self.history.clear();
        }
        self.history.add(&registration.map_from_base(), || answer.pose_stamped());
        if self.path.has_listeners()
            && let Some(poses) = self.history.due(now)
        {
            self.path.send(|| Path { header: answer.map_header(), poses });
        }
        for marker in matched_points.into_iter().flat_map(|points| answer.markers(points)) {
            self.debug.send(|| marker);
        }
    }
}
