//! The node's side of the segment: acquires the ownership, and writes the node's fields.

use std::os::fd::{AsFd, OwnedFd};
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release, SeqCst};
use std::thread;
use std::time::Duration;

use rustix::fs::{FlockOperation, Mode, fchmod, flock, fstat, ftruncate};
use rustix::io::Errno;
use rustix::shm::OFlags;

use super::error::{Problem, SharedMemoryError};
use super::estimate::SharedEstimate;
use super::futex;
use super::layout::{MAGIC, SIZE, VERSION};
use super::mapping::Mapping;
use super::name;

/// Maximum number of attempts to become the owner. An attempt can fail because a controller that checks whether the owner is
/// alive holds the lock for a moment, or because another node replaces the same stale segment.
const MAX_ATTEMPTS: u32 = 20;
/// Pause after a failed attempt.
const ATTEMPT_PAUSE: Duration = Duration::from_millis(5);

/// The owner of a segment. Only one thread at a time may call its methods, because they only load and store.
#[derive(Debug)]
pub(super) struct Server {
    mapping: Mapping,
    name: String,
}

impl Server {
    /// Creates the segment. Replaces an existing one whose owner has died, whatever its content.
    pub(super) fn create(name: &str) -> Result<Self, SharedMemoryError> {
        let file = acquire_file(name).map_err(|problem| problem.of(name))?;
        let mapping = new_segment(file).map_err(|problem| problem.of(name))?;
        Ok(Self { mapping, name: name.to_owned() })
    }

    /// Name of the segment.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Number of requests made.
    pub(super) fn requested(&self) -> u32 {
        self.mapping.controller.requested.load(Acquire)
    }

    /// Number of the last answered request.
    pub(super) fn acknowledged(&self) -> u32 {
        self.mapping.node.acknowledged.load(Relaxed)
    }

    /// Sets whether requests must wake [`Self::wait_for_request`].
    pub(super) fn set_idle(&self, idle: bool) {
        self.mapping.node.idle.store(idle.into(), SeqCst);
    }

    /// Answers every request made so far with the newest estimate. Returns whether there was one.
    pub(super) fn acknowledge(&self) -> bool {
        // Must come after `set_idle`: the controller's side relies on this order.
        let requested = self.mapping.controller.requested.load(SeqCst);
        let unanswered = requested != self.acknowledged();
        if unanswered {
            self.mapping.node.acknowledged.store(requested, Release);
        }
        unanswered
    }

    /// Writes the newest estimate and counts it. Returns its number.
    pub(super) fn complete(&self, estimate: &SharedEstimate) -> u32 {
        let number = self.mapping.node.completed.load(Relaxed).wrapping_add(1);
        self.mapping.estimate.write(number, estimate);
        self.mapping.node.completed.store(number, Release);
        number
    }

    /// Wakes all controllers that wait for an answer.
    pub(super) fn announce_answer(&self) {
        futex::wake_all(&self.mapping.node.acknowledged);
    }

    /// Wakes all controllers that wait for an estimate.
    pub(super) fn announce_completion(&self) {
        futex::wake_all(&self.mapping.node.completed);
    }

    /// Sleeps until a request after the first `seen` ones is made while the node is idle. May return early.
    pub(super) fn wait_for_request(&self, seen: u32, timeout: Duration) {
        futex::sleep(&self.mapping.controller.requested, seen, timeout);
    }

    /// Wakes a thread that sleeps in [`Self::wait_for_request`] now.
    pub(super) fn interrupt_wait(&self) {
        futex::wake_all(&self.mapping.controller.requested);
    }

    #[cfg(test)]
    pub(super) fn segment(&self) -> &super::layout::Segment {
        &self.mapping
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.mapping.identity.closed.store(1, Release);
        self.announce_answer();
        self.announce_completion();
        // If someone has removed the file, the name may belong to another segment by now.
        if is_linked(self.mapping.file()) {
            let _ = rustix::shm::unlink(&self.name); // if it fails, the next node replaces the stale segment
        }
    }
}

/// Creates an empty file of that name, locked by this process.
///
/// A file may be removed only by the process that holds its lock. So a process that gets the lock of a file that is still linked
/// is its only owner. If the file is empty it is new; otherwise it is stale and is removed.
fn acquire_file(name: &str) -> Result<OwnedFd, Problem> {
    for _ in 0..MAX_ATTEMPTS {
        let file = name::open(name, OFlags::CREATE)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Err(Errno::WOULDBLOCK) => thread::sleep(ATTEMPT_PAUSE),
            Err(errno) => return Err(Problem::system("lock the segment", errno)),
            Ok(()) if !is_linked(&file) => {}
            Ok(()) if is_new(&file) => return Ok(file),
            Ok(()) => rustix::shm::unlink(name).map_err(|errno| Problem::system("remove the stale segment", errno))?,
        }
    }
    let owner =
        name::open(name, OFlags::empty()).and_then(Mapping::new).map_or(0, |mapping| mapping.identity.owner.load(Relaxed));
    Err(Problem::InUse { owner })
}

fn is_linked(file: impl AsFd) -> bool {
    fstat(file).is_ok_and(|status| status.st_nlink > 0)
}

/// Whether the file is empty and belongs to this user. Another user could truncate a file of theirs while it is mapped.
fn is_new(file: impl AsFd) -> bool {
    fstat(file).is_ok_and(|status| status.st_size == 0 && status.st_uid == rustix::process::geteuid().as_raw())
}

/// Initializes a segment in an empty file; the node is idle.
fn new_segment(file: OwnedFd) -> Result<Mapping, Problem> {
    let system_error = |errno| Problem::system("set up the segment", errno);
    fchmod(&file, Mode::RUSR | Mode::WUSR).map_err(system_error)?; // a stale empty file may be open to others
    ftruncate(&file, SIZE.into()).map_err(system_error)?;
    let mapping = Mapping::new(file)?;
    mapping.node.idle.store(1, Relaxed);
    let identity = &mapping.identity;
    identity.version.store(VERSION, Relaxed);
    identity.size.store(SIZE, Relaxed);
    identity.owner.store(std::process::id(), Relaxed);
    identity.magic.store(MAGIC, Release);
    Ok(mapping)
}
