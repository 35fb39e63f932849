//! The receiving end of a topic: bytes that are said to be of the right type, with the time they came.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use rosrust::api::Ros;
use rosrust::{RawMessage, Subscriber, SubscriptionHandler};

use super::NodeError;
use super::log::Log;
use super::master::{Role, resolved};
use crate::anytime::clock::Clock;
use crate::messages::Message;

/// rosrust's own queue loses messages without a word when it is short. Ours only ever passes through it: the receiver decides what is
/// kept.
const QUEUE: usize = 1000;

/// A message as it came.
#[derive(Debug, PartialEq)]
pub(super) struct Letter {
    /// Reading of the clock when it came.
    pub(super) arrival: Duration,
    /// Name of the node that sent it.
    pub(super) sender: String,
    /// Its wire form.
    pub(super) bytes: Vec<u8>,
}

/// A topic to listen to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Topic {
    /// Its name before remapping.
    pub(super) name: &'static str,
    message_type: &'static str,
    md5: &'static str,
}

impl Topic {
    pub(super) fn of<T: Message>(name: &'static str) -> Self {
        Self { name, message_type: T::TYPE, md5: T::MD5 }
    }

    /// How it stands in the master's books.
    pub(super) fn role(self) -> Role {
        Role::Subscriber { topic: self.name, message_type: self.message_type.into() }
    }
}

/// Subscribes to `topic`; what comes goes to `receive`, which must not be slow.
///
/// Raw: rosrust would decode lengths it has not checked, and any publisher could make it take all memory there is.
pub(super) fn listen(
    ros: &Ros,
    topic: Topic,
    clock: &Arc<dyn Clock>,
    log: &Log,
    receive: impl FnMut(Letter) + Send + 'static,
) -> Result<Subscriber, NodeError> {
    let name = resolved(ros, topic.name)?;
    let inlet = Inlet { topic, name, clock: Arc::clone(clock), log: log.clone(), refused: HashSet::new(), receive };
    ros.subscribe_with(topic.name, QUEUE, inlet).map_err(|error| NodeError::ros(format!("subscribe to '{}'", topic.name), &error))
}

struct Inlet<F> {
    topic: Topic,
    /// The topic's name in full.
    name: String,
    clock: Arc<dyn Clock>,
    log: Log,
    refused: HashSet<String>,
    receive: F,
}

impl<F: FnMut(Letter) + Send + 'static> SubscriptionHandler<RawMessage> for Inlet<F> {
    fn connection(&mut self, headers: HashMap<String, String>) {
        let field = |name: &str| headers.get(name).map_or("", String::as_str);
        let Topic { message_type, md5, .. } = self.topic;
        let sender = field("callerid");
        if [md5, "*"].contains(&field("md5sum")) {
            self.refused.remove(sender);
        } else if self.refused.insert(sender.into()) {
            let version = if field("type") == message_type { " of another version" } else { "" };
            self.log.error(&format!(
                "topic {}: {sender} publishes {}{version}, expected {message_type}: its messages are ignored",
                self.name,
                field("type"),
            ));
        }
    }

    // A message may overtake the header of its connection. Of a wrong type, it is then refused by the decoder.
    fn message(&mut self, message: RawMessage, sender: &str) {
        let arrival = self.clock.now();
        if !self.refused.contains(sender) {
            (self.receive)(Letter { arrival, sender: sender.into(), bytes: message.0 });
        }
    }
}
