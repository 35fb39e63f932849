//! The ROS messages this project reads and writes, and their wire form.
//!
//! One set of types serves bags and live connections alike, with or without the `ros` feature, so that both go through the same
//! length-checked decoder. Field names are those of the message definitions.

pub mod ackermann_msgs;
pub mod geometry_msgs;
pub mod nav_msgs;
pub mod own;
pub mod sensor_msgs;
pub mod std_msgs;
pub mod tf2_msgs;

use std::fmt::Write as _;

use speedy::{LittleEndian, Readable, Writable};
use thiserror::Error;

use crate::time::Stamp;

/// A message type as bags and connections name it.
pub trait Message: for<'a> Readable<'a, LittleEndian> + Writable<LittleEndian> {
    /// `package/Name`.
    const TYPE: &'static str;
    /// Checksum of the definition, as ROS computes it.
    const MD5: &'static str;
    /// Type and text of the definition and of every type it is made of, itself first.
    const DEFINITIONS: &'static [(&'static str, &'static str)];

    /// The full definition as connections and bags carry it: the message's own text, then that of each type it is made of.
    fn full_definition() -> String {
        let mut text = String::new();
        for (i, (name, definition)) in Self::DEFINITIONS.iter().enumerate() {
            if i > 0 {
                let _ = writeln!(text, "\n{}\nMSG: {name}", "=".repeat(80));
            }
            text.push_str(definition);
        }
        text
    }
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
