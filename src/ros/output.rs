//! A published topic.

use std::marker::PhantomData;
use std::sync::Arc;

use rosrust::api::Ros;
use rosrust::{Publisher, RawMessage, RawMessageDescription};

use super::NodeError;
use super::master::{MasterRegistration, resolved, track_registration};
use super::node_api::list_publisher;
use super::priority::with_real_time_priority;
use crate::messages::{Message, encode};

/// Queue size per subscriber. A bag played fast makes bursts of answers, and no edge of `icp_state` may be lost.
const QUEUE: usize = 100;

/// A publisher of messages of one type.
///
/// Messages are serialized here, since rosrust would replace stamps of zero by the current time, and sequence numbers by its own.
pub(super) struct Output<T> {
    resolved: String,
    publisher: Arc<Publisher<RawMessage>>,
    message: PhantomData<fn(T)>,
    _registration: Arc<MasterRegistration>,
}

impl<T: Message> Output<T> {
    pub(super) fn new(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        let definition = T::definition();
        let description = RawMessageDescription {
            msg_definition: definition.text.clone(),
            md5sum: definition.md5.clone(),
            msg_type: T::TYPE.into(),
        };
        let publisher = ros
            .publish_with_description(topic, QUEUE, description)
            .map_err(|error| NodeError::ros(format!("publish '{topic}'"), &error))?;
        let resolved = resolved(ros, topic)?;
        let publisher = list_publisher(resolved.clone(), publisher);
        let registration = track_registration(ros, MasterRegistration::Publisher { topic, message_type: T::TYPE })?;
        Ok(Self { resolved, publisher, message: PhantomData, _registration: registration })
    }

    /// A topic that a controller waits for: the thread that writes its messages to the sockets runs with real-time priority.
    pub(super) fn urgent(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        with_real_time_priority(|| Self::new(ros, topic))
    }

    /// A latched topic.
    pub(super) fn latched(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        let output = Self::new(ros, topic)?;
        let mut publisher = Publisher::clone(&output.publisher);
        publisher.set_latching(true);
        Ok(Self { publisher: list_publisher(output.resolved.clone(), publisher), ..output })
    }

    pub(super) fn has_subscribers(&self) -> bool {
        self.publisher.subscriber_count() > 0
    }

    /// Publishes a message if there is a subscriber. `message` is called only then.
    pub(super) fn send(&self, message: impl FnOnce() -> T) {
        if self.has_subscribers() {
            self.send_always(&message());
        }
    }

    /// Publishes a message even without a subscriber: on a latched topic, later subscribers receive it.
    pub(super) fn send_always(&self, message: &T) {
        // Neither call can fail: `encode` writes to memory, and `send` only queues.
        let _ = self.publisher.send(RawMessage(encode(message).unwrap_or_default()));
    }
}
