//! Connections: who published what on which topic.

use crate::messages::Message;

use super::record::Fields;

/// One publisher's messages on one topic. A topic that several nodes publish has several connections.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// Number within the bag.
    pub id: u32,
    /// Topic, as recorded.
    pub topic: String,
    /// Type of the messages: `package/Name`.
    pub message_type: String,
    /// Checksum of the type's definition; `*` when the publisher did not tell.
    pub md5: String,
    /// The full definition of the type.
    pub definition: String,
    /// Whether late subscribers get the last message.
    pub latching: bool,
    /// Number of its messages in the bag.
    pub messages: u64,
}

impl Connection {
    /// Whether its messages have the wire form of `T`. A type that was renamed and not changed (`tf/tfMessage`) serves too.
    pub fn carries<T: Message>(&self) -> bool {
        match self.md5.as_str() {
            "*" => self.message_type == T::TYPE || self.message_type == "*",
            md5 => md5 == T::MD5,
        }
    }

    /// From the header and data of a connection record. The data is itself a header: that of the TCP connection.
    pub(super) fn parse(record: Fields<'_>, data: &[u8]) -> Result<Self, String> {
        let header = Fields(data);
        Ok(Self {
            id: record.u32("conn")?,
            topic: record.text("topic")?.into_owned(),
            message_type: header.text("type")?.into_owned(),
            md5: header.text("md5sum")?.into_owned(),
            definition: header.text("message_definition").unwrap_or_default().into_owned(),
            latching: header.bytes("latching") == Ok(b"1"),
            messages: 0,
        })
    }
}
