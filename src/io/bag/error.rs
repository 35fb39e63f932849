//! Errors and problems of a bag: an error ends the reading; after a problem, which is a loss of data, reading continues.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::messages::DecodeError;
use crate::time::Stamp;

/// Why a bag cannot be read or written. As usual, the message does not include that of the `source`; `anyhow`'s `{:#}` adds it.
#[derive(Debug, Error)]
pub enum BagError {
    /// The operating system reported an error.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operation that failed: `open`, `read`, ...
        action: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is not a bag.
    #[error("{} is not a ROS 1 bag: {reason}", path.display())]
    NotABag {
        /// The file.
        path: PathBuf,
        /// How the file differs from a bag.
        reason: String,
    },
    /// A bag of a kind that this reader does not support.
    #[error("{} is {what}; {remedy}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The kind of bag.
        what: String,
        /// What to do about it.
        remedy: &'static str,
    },
    /// The bag has no such topic.
    #[error("{}: there is no topic {topic}; {alternatives}", path.display())]
    NoSuchTopic {
        /// The file.
        path: PathBuf,
        /// The requested topic.
        topic: String,
        /// Text that lists the topics with messages of the requested type.
        alternatives: String,
    },
    /// The topic carries messages of another type.
    #[error("{}: topic {topic} carries {found}, but {expected} is needed", path.display())]
    WrongType {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its type.
        found: String,
        /// The requested type.
        expected: &'static str,
    },
    /// The type has the right name, but another definition than when it was recorded.
    #[error(
        "{}: topic {topic} carries another version of {message_type} (md5 {found}, needed {expected}); \
         convert the bag with `rosbag fix`",
        path.display()
    )]
    WrongVersion {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Name of the type.
        message_type: &'static str,
        /// MD5 sum of the recorded definition.
        found: String,
        /// MD5 sum of the requested definition.
        expected: &'static str,
    },
    /// The bytes of a message do not match its type.
    #[error("{}: cannot decode the message on {topic} recorded at {time} s (chunk at byte {chunk_offset})", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Time of recording.
        time: Stamp,
        /// Start of the chunk that contains it, bytes from the start of the file.
        chunk_offset: u64,
        /// How it differs from its type.
        source: DecodeError,
    },
    /// A message that cannot be written to a bag.
    #[error("cannot write to {} on {topic}: {reason}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Why not.
        reason: String,
    },
}

impl BagError {
    /// Makes an [`BagError::Io`]: for `map_err` after a file operation.
    pub(super) fn io<'a>(path: &'a Path, action: &'static str) -> impl FnOnce(io::Error) -> Self + use<'a> {
        move |source| Self::Io { path: path.to_path_buf(), action, source }
    }
}

/// A part of a bag that could not be read; the rest was.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagProblem {
    /// Where it begins, bytes from the start of the file.
    pub offset: u64,
    /// What is wrong there.
    pub what: String,
    /// Bytes that could not be used.
    pub bytes_lost: u64,
    /// What to do about it.
    pub remedy: &'static str,
}

impl fmt::Display for BagProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at byte {}: {}", self.offset, self.what)?;
        if self.bytes_lost > 0 {
            write!(f, "; {} bytes lost", self.bytes_lost)?;
        }
        write!(f, " ({})", self.remedy)
    }
}

/// Remedy for a bag that was not closed, or not copied completely.
pub(super) const REINDEX: &str = "run `rosbag reindex` on a copy of the bag";
/// Remedy for a bag with corrupted bytes.
pub(super) const COPY_AGAIN: &str = "copy the bag again from the machine that recorded it";
