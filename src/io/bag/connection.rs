//! Connections: one for each publisher and topic.

use std::borrow::Cow;

use crate::messages::Message;

use super::record::Fields;

/// Placeholder for an unknown type or checksum.
const UNKNOWN: Cow<'static, str> = Cow::Borrowed("*");

/// One publisher's messages on one topic. A topic that several nodes publish has several connections.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// Number within the bag.
    pub id: u32,
    /// Name of the topic, as recorded.
    pub topic: String,
    /// Type of the messages: `package/Name`.
    pub message_type: String,
    /// MD5 sum of the type's definition; `*` if the publisher or the recorder did not give it.
    pub md5: String,
    /// The full definition of the type.
    pub definition: String,
    /// Whether the topic is latched: late subscribers get the last message.
    pub latching: bool,
    /// Number of its messages in the bag.
    pub messages: u64,
}

impl Connection {
    /// Whether its messages can be decoded as `T`. A type that was renamed but not changed (`tf/tfMessage`) is accepted, too.
    pub fn carries<T: Message>(&self) -> bool {
        match self.md5.as_str() {
            "*" => self.message_type == T::TYPE || self.message_type == "*" || self.has_definition(&T::definition().text),
            md5 => md5 == T::definition().md5,
        }
    }

    /// Whether its definition equals this one, apart from comments and white space.
    fn has_definition(&self, definition: &str) -> bool {
        fn words(text: &str) -> impl Iterator<Item = &str> {
            text.lines().flat_map(|line| line.split('#').next().unwrap_or_default().split_whitespace())
        }
        !self.definition.is_empty() && words(&self.definition).eq(words(definition))
    }

    /// Parses the header and data of a connection record. The data is itself a header: that of the TCP connection. Only the
    /// number and the topic are required.
    pub(super) fn parse(record: Fields<'_>, data: &[u8]) -> Result<Self, String> {
        let header = Fields(data);
        Ok(Self {
            id: record.u32("conn")?,
            topic: record.text("topic").or_else(|_| header.text("topic"))?.into_owned(),
            message_type: header.text("type").unwrap_or(UNKNOWN).into_owned(),
            md5: header.text("md5sum").unwrap_or(UNKNOWN).into_owned(),
            definition: header.text("message_definition").unwrap_or_default().into_owned(),
            latching: header.bytes("latching") == Ok(b"1"),
            messages: 0,
        })
    }
}
