//! The ROS messages that this project reads and writes, and their serialization.
//!
//! Bags and live connections use the same types, with or without the `ros` feature, so that both go through the same
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

/// Name and definition of every message type, by package.
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

/// Name of a type, and type and name of each of its fields.
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

/// A message type.
pub trait Message: for<'a> Readable<'a, LittleEndian> + Writable<LittleEndian> {
    /// Name of the type as in bags and connections: `package/Name`.
    const TYPE: &'static str;

    /// Full definition and MD5 sum of the type.
    fn definition() -> &'static Definition;
}

/// Bytes are not a valid message of the expected type.
#[derive(Clone, Debug, Error)]
#[error("{len} bytes are not a valid {message_type}: {problem}")]
pub struct DecodeError {
    /// The type expected.
    pub message_type: &'static str,
    /// Number of bytes.
    pub len: usize,
    /// What is wrong.
    pub problem: String,
}

/// Deserializes a message. Lengths are checked against the available bytes before memory is allocated.
pub fn decode<T: Message>(bytes: &[u8]) -> Result<T, DecodeError> {
    let error = |problem: String| DecodeError { message_type: T::TYPE, len: bytes.len(), problem };
    let (message, length) = T::read_with_length_from_buffer(bytes);
    let message = message.map_err(|e| error(e.to_string()))?;
    if length < bytes.len() {
        return Err(error("there are extra bytes at the end".into()));
    }
    Ok(message)
}

/// Reads only the stamp of a message that begins with a header. `None` if there are too few bytes.
pub fn header_stamp(bytes: &[u8]) -> Option<Stamp> {
    let word = |start: usize| bytes.get(start..)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
    Some(Time { sec: word(4)?, nsec: word(8)? }.into())
}

/// Reads only the header of a message that begins with one. `None` if there are too few bytes.
pub fn header(bytes: &[u8]) -> Option<std_msgs::Header> {
    std_msgs::Header::read_from_buffer(bytes).ok()
}

/// Serializes a message.
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

/// Durations that are too long are clamped.
impl From<std::time::Duration> for Duration {
    fn from(span: std::time::Duration) -> Self {
        Self { sec: i32::try_from(span.as_secs()).unwrap_or(i32::MAX), nsec: span.subsec_nanos().cast_signed() }
    }
}

impl Duration {
    /// The duration in seconds.
    pub fn seconds(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nsec) * 1e-9
    }

    /// The duration as a [`std::time::Duration`]; zero if it is negative.
    pub fn span(self) -> std::time::Duration {
        std::time::Duration::try_from_secs_f64(self.seconds()).unwrap_or_default()
    }
}
