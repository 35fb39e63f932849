//! What can go wrong with a segment.

use std::io;
use std::time::Duration;

use thiserror::Error;

/// A problem with one segment.
#[derive(Debug, Error)]
#[error("shared memory {name}: {problem}")]
pub struct SharedMemoryError {
    /// Name of the segment.
    pub name: String,
    /// What is wrong with it, and what helps.
    pub problem: Problem,
}

/// What is wrong with a segment, and what helps.
#[derive(Debug, Error)]
pub enum Problem {
    /// The name cannot be one of a segment.
    #[error("not a name: give 1 to 254 characters without any / after the first one, for example /anytime_scan_matcher")]
    BadName,
    /// There is no segment of that name.
    #[error("there is no such segment: start the node, and give both the same name")]
    Absent,
    /// It belongs to another user.
    #[error("access denied, as it belongs to another user: run the node and the controller as the same user")]
    Denied,
    /// The operating system refused.
    #[error("cannot {action}: {source}; is /dev/shm there, and not full?")]
    System {
        /// What was tried.
        action: &'static str,
        /// What came of it.
        source: io::Error,
    },
    /// Another node serves it.
    #[error("process {owner} serves it: stop that process, or choose another name")]
    Owned {
        /// Id of that process; 0 if it has not written it yet.
        owner: u32,
    },
    /// The file is too short or too long.
    #[error(
        "it has {found} bytes instead of {expected}: if it has 0, the node is just starting, try again; \
         else bring node and controller to the same version"
    )]
    WrongSize {
        /// Size found, bytes.
        found: i64,
        /// Size of this version, bytes.
        expected: u32,
    },
    /// The first bytes are not those of a segment of this project.
    #[error(
        "it begins with {found:#018x} instead of {expected:#018x}: if that is 0, the node is just starting, try again; \
         else another program uses this name, choose another one"
    )]
    WrongMagic {
        /// What is there.
        found: u64,
        /// What should be there.
        expected: u64,
    },
    /// Node and controller were built for different layouts.
    #[error("it has layout version {found}, this program knows {expected}: bring node and controller to the same version")]
    WrongVersion {
        /// Version found.
        found: u32,
        /// Version of this program.
        expected: u32,
    },
    /// The node has ended without closing it.
    #[error("process {owner}, which served it, is gone: open it again once the node is back")]
    OwnerDied {
        /// Id that process had.
        owner: u32,
    },
    /// The node has closed it.
    #[error("the node has closed it: open it again once the node is back")]
    Closed,
    /// Nothing came in time.
    #[error("no {awaited} within {timeout:?}: try again, or allow more time")]
    TimedOut {
        /// What was waited for.
        awaited: &'static str,
        /// How long.
        timeout: Duration,
    },
    /// The node has begun to write an estimate and does not go on.
    #[error("the newest estimate is half written and stays so: the node is stopped, or starved of processor time")]
    HalfWritten,
}

impl Problem {
    /// A refusal of the operating system; that of a missing segment, or of another user's, has its own remedy.
    pub(super) fn system(action: &'static str, source: rustix::io::Errno) -> Self {
        match source {
            rustix::io::Errno::NOENT => Self::Absent,
            rustix::io::Errno::ACCESS | rustix::io::Errno::PERM => Self::Denied,
            _ => Self::System { action, source: source.into() },
        }
    }

    /// With the name of the segment.
    pub(super) fn of(self, name: &str) -> SharedMemoryError {
        SharedMemoryError { name: name.to_owned(), problem: self }
    }
}
