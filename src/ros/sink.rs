//! The receiving end of a topic: raw messages of the declared type with their arrival times.

use std::collections::HashSet;
use std::time::Duration;

use super::log::Log;
use super::master::MasterRegistration;
use super::tcpros::Header;
use crate::messages::Message;

/// A message in serialized form.
#[derive(Debug, PartialEq)]
pub(super) struct RawMessage {
    /// Arrival time on the node's clock.
    pub(super) arrival: Duration,
    /// Name of the node that sent it.
    pub(super) sender: String,
    /// The serialized message.
    pub(super) bytes: Vec<u8>,
}

/// A topic to subscribe to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Topic {
    /// Name before remapping.
    pub(super) name: &'static str,
    pub(super) message_type: &'static str,
    md5: &'static str,
    /// The node cannot work without it: while it has no publisher, the master is polled more often.
    pub(super) is_required: bool,
}

impl Topic {
    pub(super) fn of<T: Message>(name: &'static str) -> Self {
        Self { name, message_type: T::TYPE, md5: &T::definition().md5, is_required: false }
    }

    /// The registration with the master.
    pub(super) fn registration(self) -> MasterRegistration {
        MasterRegistration::Subscriber { topic: self.name, message_type: self.message_type }
    }
}

/// Receives the messages of a topic.
pub(super) struct Sink {
    pub(super) topic: Topic,
    /// Publishers of another type, about which an error has been logged.
    mismatched: HashSet<String>,
    receive: Box<dyn FnMut(RawMessage) + Send>,
}

impl Sink {
    /// Each message is passed to `receive`, which must be fast.
    pub(super) fn new(topic: Topic, receive: impl FnMut(RawMessage) + Send + 'static) -> Self {
        Self { topic, mismatched: HashSet::new(), receive: Box::new(receive) }
    }

    /// Whether the header of a connection announces the right type. If not, an error is logged once per publisher.
    pub(super) fn accepts(&mut self, header: &Header, sender: &str, topic: &str, log: &Log) -> bool {
        let field = |name: &str| header.get(name).map_or("", String::as_str);
        let Topic { message_type, md5, .. } = self.topic;
        let fits = [md5, "*"].contains(&field("md5sum"));
        if fits {
            self.mismatched.remove(sender);
        } else if self.mismatched.insert(sender.into()) {
            let version = if field("type") == message_type { " with another definition (MD5 sum)" } else { "" };
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
