//! The receiving end of a topic: bytes that are said to be of the right type, with the time they came.

use std::collections::HashSet;
use std::time::Duration;

use super::log::Log;
use super::master::MasterRegistration;
use super::tcpros::Header;
use crate::messages::Message;

/// A message as it came.
#[derive(Debug, PartialEq)]
pub(super) struct RawMessage {
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
    pub(super) message_type: &'static str,
    md5: &'static str,
    /// The node needs it: while it has no publisher, the master is polled more often.
    pub(super) is_vital: bool,
}

impl Topic {
    pub(super) fn of<T: Message>(name: &'static str) -> Self {
        Self { name, message_type: T::TYPE, md5: &T::definition().md5, is_vital: false }
    }

    pub(super) fn vital<T: Message>(name: &'static str) -> Self {
        Self { is_vital: true, ..Self::of::<T>(name) }
    }

    /// How it is registered with the master.
    pub(super) fn registration(self) -> MasterRegistration {
        MasterRegistration::Subscriber { topic: self.name, message_type: self.message_type }
    }
}

/// Where the messages of a topic go.
pub(super) struct Sink {
    pub(super) topic: Topic,
    /// Nodes whose messages are of another type.
    refused: HashSet<String>,
    receive: Box<dyn FnMut(RawMessage) + Send>,
}

impl Sink {
    /// What comes goes to `receive`, which must not be slow.
    pub(super) fn new(topic: Topic, receive: impl FnMut(RawMessage) + Send + 'static) -> Self {
        Self { topic, refused: HashSet::new(), receive: Box::new(receive) }
    }

    /// Whether what comes over the connection of this header is of the right type. If it is not, that is said once.
    pub(super) fn accepts(&mut self, header: &Header, sender: &str, topic: &str, log: &Log) -> bool {
        let field = |name: &str| header.get(name).map_or("", String::as_str);
        let Topic { message_type, md5, .. } = self.topic;
        let fits = [md5, "*"].contains(&field("md5sum"));
        if fits {
            self.refused.remove(sender);
        } else if self.refused.insert(sender.into()) {
            let version = if field("type") == message_type { " of another version" } else { "" };
            log.error(&format!(
                "topic {topic}: {sender} publishes {}{version}, expected {message_type}: its messages are ignored",
                field("type"),
            ));
        }
        fits
    }

    pub(super) fn message(&mut self, bytes: Vec<u8>, sender: &str, arrival: Duration) {
        (self.receive)(RawMessage { arrival, sender: sender.into(), bytes });
    }
}
