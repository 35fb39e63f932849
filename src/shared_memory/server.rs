//! The node's side of the segment: who owns it, and what it writes.

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

/// Attempts to become the owner. A controller that looks whether the owner lives holds the lock for a moment, and another node may
/// be taking over the same stale segment.
const ATTEMPTS: u32 = 20;
const BETWEEN_ATTEMPTS: Duration = Duration::from_millis(5);

/// The owner of a segment. Its methods are for one thread at a time: they only load and store.
#[derive(Debug)]
pub(super) struct Server {
    mapping: Mapping,
    name: String,
}

impl Server {
    /// Creates the segment; takes the place of one whose owner is gone, whatever its form.
    pub(super) fn create(name: &str) -> Result<Self, SharedMemoryError> {
        let file = own(name).map_err(|problem| problem.of(name))?;
        let mapping = new_segment(file).map_err(|problem| problem.of(name))?;
        Ok(Self { mapping, name: name.to_owned() })
    }

    /// Name of the segment.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Requests ever made.
    pub(super) fn requested(&self) -> u32 {
        self.mapping.controller.requested.load(Acquire)
    }

    /// Number of the last request answered.
    pub(super) fn acknowledged(&self) -> u32 {
        self.mapping.node.acknowledged.load(Relaxed)
    }

    /// Whether requests must wake [`Self::await_request`].
    pub(super) fn set_idle(&self, idle: bool) {
        self.mapping.node.idle.store(idle.into(), SeqCst);
    }

    /// Answers every request made so far with the newest estimate; whether there was any to answer.
    pub(super) fn acknowledge(&self) -> bool {
        // After `set_idle`, in the order that the controller's side relies on.
        let requested = self.mapping.controller.requested.load(SeqCst);
        let unanswered = requested != self.acknowledged();
        if unanswered {
            self.mapping.node.acknowledged.store(requested, Release);
        }
        unanswered
    }

    /// Writes the newest estimate and counts it; its number.
    pub(super) fn complete(&self, estimate: &SharedEstimate) -> u32 {
        let number = self.mapping.node.completed.load(Relaxed).wrapping_add(1);
        self.mapping.estimate.write(number, estimate);
        self.mapping.node.completed.store(number, Release);
        number
    }

    /// Wakes those who wait for an answer.
    pub(super) fn announce_answer(&self) {
        futex::wake_all(&self.mapping.node.acknowledged);
    }

    /// Wakes those who wait for an estimate.
    pub(super) fn announce_completion(&self) {
        futex::wake_all(&self.mapping.node.completed);
    }

    /// Sleeps until a request is made beyond those `seen`, and the node is idle. May return early.
    pub(super) fn await_request(&self, seen: u32, longest: Duration) {
        futex::sleep(&self.mapping.controller.requested, seen, longest);
    }

    /// Ends [`Self::await_request`] of a thread that sleeps in it now.
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
        // Unless somebody has removed it: then the name may be another's by now.
        if is_linked(self.mapping.file()) {
            let _ = rustix::shm::unlink(&self.name); // what is left behind is stale, and taken over by the next
        }
    }
}

/// An empty file of that name, locked by this process.
///
/// Only who holds the lock on the file that has the name removes it. So whoever gets the lock, and finds the file still linked, is
/// alone: a stale one is removed, an empty one is a new one.
fn own(name: &str) -> Result<OwnedFd, Problem> {
    for _ in 0..ATTEMPTS {
        let file = name::open(name, OFlags::CREATE)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Err(Errno::WOULDBLOCK) => thread::sleep(BETWEEN_ATTEMPTS),
            Err(errno) => return Err(Problem::system("lock the segment", errno)),
            Ok(()) if !is_linked(&file) => {}
            Ok(()) if is_new(&file) => return Ok(file),
            Ok(()) => rustix::shm::unlink(name).map_err(|errno| Problem::system("remove the stale segment", errno))?,
        }
    }
    let owner =
        name::open(name, OFlags::empty()).and_then(Mapping::new).map_or(0, |mapping| mapping.identity.owner.load(Relaxed));
    Err(Problem::Owned { owner })
}

fn is_linked(file: impl AsFd) -> bool {
    fstat(file).is_ok_and(|status| status.st_nlink > 0)
}

/// Whether the file is empty, and this user's: another's might be shortened under our feet.
fn is_new(file: impl AsFd) -> bool {
    fstat(file).is_ok_and(|status| status.st_size == 0 && status.st_uid == rustix::process::geteuid().as_raw())
}

/// Makes a segment of an empty file, of a node that is idle.
fn new_segment(file: OwnedFd) -> Result<Mapping, Problem> {
    let refused = |errno| Problem::system("set up the segment", errno);
    fchmod(&file, Mode::RUSR | Mode::WUSR).map_err(refused)?; // a stale empty file may be open to others
    ftruncate(&file, SIZE.into()).map_err(refused)?;
    let mapping = Mapping::new(file)?;
    mapping.node.idle.store(1, Relaxed);
    let identity = &mapping.identity;
    identity.version.store(VERSION, Relaxed);
    identity.size.store(SIZE, Relaxed);
    identity.owner.store(std::process::id(), Relaxed);
    identity.magic.store(MAGIC, Release);
    Ok(mapping)
}
