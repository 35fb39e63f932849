//! The sending end of a topic.

use std::marker::PhantomData;
use std::sync::Arc;

use rosrust::api::Ros;
use rosrust::{Publisher, RawMessage, RawMessageDescription};

use super::NodeError;
use super::master::{MasterRegistration, note, resolved};
use super::node_api::listed;
use super::priority::urgently;
use crate::messages::{Message, encode};

/// Messages that may wait for a subscriber: a bag played fast makes bursts of answers, and of `icp_state` every edge counts.
const QUEUE: usize = 100;

/// A topic that messages of one type leave by.
///
/// rosrust writes the present time over stamps of zero and its own numbers over ours, so it is given bytes.
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
        let publisher = listed(resolved.clone(), publisher);
        let registration = note(ros, MasterRegistration::Publisher { topic, message_type: T::TYPE })?;
        Ok(Self { resolved, publisher, message: PhantomData, _registration: registration })
    }

    /// A topic of what a controller waits for: the thread that writes its messages goes before all programs of normal priority.
    pub(super) fn urgent(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        urgently(|| Self::new(ros, topic))
    }

    /// A topic whose new listeners are given the last message at once.
    pub(super) fn latched(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        let output = Self::new(ros, topic)?;
        let mut publisher = Publisher::clone(&output.publisher);
        publisher.set_latching(true);
        Ok(Self { publisher: listed(output.resolved.clone(), publisher), ..output })
    }

    pub(super) fn has_listeners(&self) -> bool {
        self.publisher.subscriber_count() > 0
    }

    /// Hands a message over, if anybody listens; what it takes to make it is spent only then.
    pub(super) fn send(&self, message: impl FnOnce() -> T) {
        if self.has_listeners() {
            self.keep(&message());
        }
    }

    /// Hands a message over to whoever listens, now or, on a latched topic, later.
    pub(super) fn keep(&self, message: &T) {
        // Neither can fail: the one writes to memory, the other only queues.
        let _ = self.publisher.send(RawMessage(encode(message).unwrap_or_default()));
    }
}
