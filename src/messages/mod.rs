//! The ROS messages this project reads and writes, and their wire form.
//!
//! One set of types serves bags and live connections alike, with or without the `ros` feature, so that both go through the same
//! length-checked decoder. Field names are those of the message definitions.

pub mod ackermann_msgs;
mod definition;
pub mod diagnostic_msgs;
pub mod geometry_msgs;
pub mod nav_msgs;
pub mod own;
pub mod sensor_msgs;
pub mod std_msgs;
pub mod tf2_msgs;
pub mod visualization_msgs;

use speedy::{LittleEndian, Readable, Writable};
use thiserror::Error;

pub use definition::Definition;

use crate::time::Stamp;

/// Every message type, by package.
const TYPES: &[&[(&str, &str)]] = &[
    ackermann_msgs::TYPES,
    diagnostic_msgs::TYPES,
    geometry_msgs::TYPES,
    nav_msgs::TYPES,
    own::TYPES,
    sensor_msgs::TYPES,
    std_msgs::TYPES,
    tf2_msgs::TYPES,
    visualization_msgs::TYPES,
];

/// Name of a type, and of each field type and name.
#[cfg(test)]
type Fields = (&'static str, &'static [(&'static str, &'static str)]);

/// The fields of every type, by package.
#[cfg(test)]
const FIELDS: &[&[Fields]] = &[
    ackermann_msgs::FIELDS,
    diagnostic_msgs::FIELDS,
    geometry_msgs::FIELDS,
    nav_msgs::FIELDS,
    own::FIELDS,
    sensor_msgs::FIELDS,
    std_msgs::FIELDS,
    tf2_msgs::FIELDS,
    visualization_msgs::FIELDS,
];

/// A message type as bags and connections name it.
pub trait Message: for<'a> Readable<'a, LittleEndian> + Writable<LittleEndian> {
    /// `package/Name`.
    const TYPE: &'static str;

    /// Its definition, in full, and the checksum.
    fn definition() -> &'static Definition;
}

/// Bytes that are no message of the type they were said to be.
#[derive(Clone, Debug, Error)]
#[error("{len} bytes are not a {message_type}: {problem}")]
pub struct DecodeError {
    /// The type expected.
    pub message_type: &'static str,
    /// Number of bytes.
    pub len: usize,
    /// What does not fit.
    pub problem: String,
}

/// Reads a message from its wire form. Lengths are checked against the bytes there are before memory is taken for them.
pub fn decode<T: Message>(bytes: &[u8]) -> Result<T, DecodeError> {
    let error = |problem: String| DecodeError { message_type: T::TYPE, len: bytes.len(), problem };
    let (message, length) = T::read_with_length_from_buffer(bytes);
    let message = message.map_err(|e| error(e.to_string()))?;
    if length < bytes.len() {
        return Err(error("there are bytes left over".into()));
    }
    Ok(message)
}

/// The stamp of a message with a header, which it begins with, without reading the rest. `None`: there are too few bytes.
pub fn header_stamp(bytes: &[u8]) -> Option<Stamp> {
    let word = |start: usize| bytes.get(start..)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
    Some(Time { sec: word(4)?, nsec: word(8)? }.into())
}

/// The wire form of a message.
pub fn encode<T: Message>(message: &T) -> Result<Vec<u8>, DecodeError> {
    message.write_to_vec().map_err(|e| DecodeError { message_type: T::TYPE, len: 0, problem: e.to_string() })
}

/// A ROS `time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Readable, Writable)]
#[allow(missing_docs)]
pub struct Time {
    pub sec: u32,
    pub nsec: u32,
}

impl From<Time> for Stamp {
    fn from(time: Time) -> Self {
        Self::from_ros(time.sec, time.nsec)
    }
}

impl From<Stamp> for Time {
    fn from(stamp: Stamp) -> Self {
        let (sec, nsec) = stamp.to_ros();
        Self { sec, nsec }
    }
}

/// A ROS `duration`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Readable, Writable)]
#[allow(missing_docs)]
pub struct Duration {
    pub sec: i32,
    pub nsec: i32,
}

/// A span that is too long is cut.
impl From<std::time::Duration> for Duration {
    fn from(span: std::time::Duration) -> Self {
        Self { sec: i32::try_from(span.as_secs()).unwrap_or(i32::MAX), nsec: span.subsec_nanos().cast_signed() }
    }
}

impl Duration {
    /// The span in seconds.
    pub fn seconds(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nsec) * 1e-9
    }

    /// The span as far as it is one: zero when it is negative.
    pub fn span(self) -> std::time::Duration {
        std::time::Duration::try_from_secs_f64(self.seconds()).unwrap_or_default()
    }
}
