//! What can be wrong with a bag: errors end the reading, problems are losses after which it continues.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::messages::DecodeError;
use crate::time::Stamp;

/// Why a bag cannot be read or written. As usual the text leaves out that of the `source`; `anyhow`'s `{:#}` adds it.
#[derive(Debug, Error)]
pub enum BagError {
    /// The operating system refused.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried: `open`, `read`, ...
        action: &'static str,
        /// Its answer.
        source: io::Error,
    },
    /// The file is something else.
    #[error("{} is not a ROS 1 bag: {reason}", path.display())]
    NotABag {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        reason: String,
    },
    /// A bag, but of a kind that this reader does not read.
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
        /// The topic asked for.
        topic: String,
        /// The topics that could have been meant, in words.
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
        /// The type asked for.
        expected: &'static str,
    },
    /// The type has the right name, but was defined otherwise when it was recorded.
    #[error(
        "{}: topic {topic} carries another version of {message_type} (md5 {found}, needed {expected}); `rosbag fix` brings bags up to date",
        path.display()
    )]
    WrongVersion {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Name of the type.
        message_type: &'static str,
        /// Checksum of the recorded definition.
        found: String,
        /// Checksum of the definition asked for.
        expected: &'static str,
    },
    /// The bytes of a message do not fit its type.
    #[error("{}: the message of {time} s on {topic} (chunk at byte {chunk_offset}) cannot be decoded", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// When it was recorded.
        time: Stamp,
        /// Where the chunk that holds it begins.
        chunk_offset: u64,
        /// What does not fit.
        source: DecodeError,
    },
    /// A message that cannot go into the bag being written.
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
    /// For `map_err` after a file operation.
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
    /// Bytes of the file that went unused.
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

/// The bag was not closed, or not copied whole.
pub(super) const REINDEX: &str = "`rosbag reindex` repairs a copy";
/// The bytes are there, but wrong.
pub(super) const COPY_AGAIN: &str = "copy the bag again from where it was recorded";
