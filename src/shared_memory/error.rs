//! Errors of shared memory segments.

use std::io;
use std::time::Duration;

use thiserror::Error;

/// A problem with a segment.
#[derive(Debug, Error)]
#[error("shared memory {name}: {problem}")]
pub struct SharedMemoryError {
    /// Name of the segment.
    pub name: String,
    /// What is wrong with it, and the remedy.
    pub problem: Problem,
}

/// What is wrong with a segment, and the remedy.
#[derive(Debug, Error)]
pub enum Problem {
    /// The name is not a valid name of a segment.
    #[error("invalid name: give 1 to 254 characters without any / after the first one, for example /anytime_scan_matcher")]
    BadName,
    /// There is no segment of this name.
    #[error("there is no such segment: start the node, and give both the same name")]
    NotFound,
    /// It belongs to another user.
    #[error("access denied: it belongs to another user; run the node and the controller as the same user")]
    AccessDenied,
    /// The operating system reported another error.
    #[error("cannot {action}: {source}; check that /dev/shm exists and is not full")]
    System {
        /// The operation that failed.
        action: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Another node serves it.
    #[error("process {owner} already serves it: stop that process, or choose another name")]
    InUse {
        /// Id of that process; 0 if it has not written its id yet.
        owner: u32,
    },
    /// The file is too short or too long.
    #[error(
        "it has {found} bytes instead of {expected}: if it has 0, the node is just starting, so try again; \
         otherwise update node and controller to the same version"
    )]
    WrongSize {
        /// Actual size, bytes.
        found: i64,
        /// Size of this version, bytes.
        expected: u32,
    },
    /// The first bytes are not those of a segment of this project.
    #[error(
        "it begins with {found:#018x} instead of {expected:#018x}: if that is 0, the node is just starting, so try again; \
         otherwise another program uses this name, so choose another one"
    )]
    WrongMagic {
        /// Actual first bytes.
        found: u64,
        /// Expected first bytes.
        expected: u64,
    },
    /// Node and controller were built for different layouts.
    #[error("it has layout version {found}, but this program needs {expected}: update node and controller to the same version")]
    WrongVersion {
        /// Version of the segment.
        found: u32,
        /// Version of this program.
        expected: u32,
    },
    /// The node ended without closing it.
    #[error("process {owner}, which served it, has died: open it again once the node has been restarted")]
    OwnerDied {
        /// Id of that process.
        owner: u32,
    },
    /// The node has closed it.
    #[error("the node has closed it: open it again once the node has been restarted")]
    Closed,
    /// A wait timed out.
    #[error("no {awaited} within {timeout:?}: try again, or allow more time")]
    TimedOut {
        /// What was waited for.
        awaited: &'static str,
        /// The timeout of the wait.
        timeout: Duration,
    },
    /// The node has begun to write an estimate and does not finish.
    #[error("the newest estimate remains half written: the node is stopped, or gets no processor time")]
    HalfWritten,
}

impl Problem {
    /// An error of the operating system. A missing segment and a segment of another user have their own variants.
    pub(super) fn system(action: &'static str, source: rustix::io::Errno) -> Self {
        match source {
            rustix::io::Errno::NOENT => Self::NotFound,
            rustix::io::Errno::ACCESS | rustix::io::Errno::PERM => Self::AccessDenied,
            _ => Self::System { action, source: source.into() },
        }
    }

    /// Adds the name of the segment.
    pub(super) fn of(self, name: &str) -> SharedMemoryError {
        SharedMemoryError { name: name.to_owned(), problem: self }
    }
}
