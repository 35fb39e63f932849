//! The sending end of a topic, for this project's own message types.

use rosrust::RawMessageDescription;
use rosrust::api::Ros;

use super::NodeError;
use super::master::Role;
use super::publishers::Output;
use crate::messages::{Message, encode};

/// A topic that messages of one type leave by.
pub(super) struct Outlet<T>(Output<T>);

impl<T: Message> Outlet<T> {
    pub(super) fn new(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        let description =
            RawMessageDescription { msg_definition: T::full_definition(), md5sum: T::MD5.into(), msg_type: T::TYPE.into() };
        Ok(Self(Output::described(ros, topic, description)?))
    }

    /// A topic whose new listeners are given the last message at once.
    pub(super) fn latched(ros: &Ros, topic: &'static str) -> Result<Self, NodeError> {
        Self::new(ros, topic).map(|outlet| Self(outlet.0.latched()))
    }

    /// Hands a message over to whoever listens, now or, on a latched topic, later.
    pub(super) fn keep(&self, message: &T) {
        self.0.keep_bytes(encode(message).unwrap_or_default()); // cannot fail, either
    }

    /// Hands a message over, if anybody listens; what it takes to make it is spent only then.
    pub(super) fn send(&self, message: impl FnOnce() -> T) {
        // Cannot fail: it writes to memory.
        self.0.send_bytes(|| encode(&message()).unwrap_or_default());
    }

    pub(super) fn role(&self) -> Role {
        self.0.role()
    }
}
