//! The controller's side of the segment.

use std::hint;
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::{Acquire, Relaxed, SeqCst};
use std::thread;
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, flock};
use rustix::shm::OFlags;

use super::error::{Problem, SharedMemoryError};
use super::estimate::CompletedEstimate;
use super::futex;
use super::layout::{MAGIC, SIZE, VERSION};
use super::mapping::Mapping;
use super::name;

/// Waits look at memory for this long before they sleep: about as long as waking up takes. Longer would not help where the node has
/// the same processor, and can only answer once the controller sleeps.
pub const SPIN: Duration = Duration::from_micros(10);

/// Who sleeps looks this often whether the node still lives. (A node that closes the segment wakes all at once.)
pub const PEER_CHECK: Duration = Duration::from_millis(50);

/// Attempts to read an estimate between two writings: the first ones at once, the others [`BETWEEN_READS`] apart.
const READS_AT_ONCE: u32 = 100;
const READS: u32 = 600;
/// Lets a node go on that was stopped in the middle by a controller of higher priority.
const BETWEEN_READS: Duration = Duration::from_micros(100);

/// The number of a request: what its answer is known by. Numbers wrap around.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RequestNumber(pub u32);

impl RequestNumber {
    /// Whether a node that has answered all requests up to `acknowledged` has answered this one.
    pub const fn is_answered_by(self, acknowledged: u32) -> bool {
        has_reached(acknowledged, self.0)
    }
}

/// Whether a count that wraps around is at `bound` or beyond: right as long as they are less than 2^31 apart.
const fn has_reached(count: u32, bound: u32) -> bool {
    count.wrapping_sub(bound) < 1 << 31
}

/// What has been counted so far. All counts wrap around.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Number of the last request answered, and with it of all before.
    pub acknowledged: u32,
    /// Requests made.
    pub requested: u32,
    /// Estimates completed. The parity is the value of the topic `icp_state`.
    pub completed: u32,
}

/// A controller's hold on a segment. All methods may be used from several threads at once.
#[derive(Debug)]
pub struct Client {
    mapping: Mapping,
    name: String,
}

impl Client {
    /// Opens the segment of a node that runs.
    pub fn open(name: &str) -> Result<Self, SharedMemoryError> {
        let mapping = name::open(name, OFlags::empty()).and_then(Mapping::new).map_err(|problem| problem.of(name))?;
        let client = Self { mapping, name: name.to_owned() };
        client.check_identity().and_then(|()| client.check_peer()).map_err(|problem| problem.of(name))?;
        Ok(client)
    }

    /// Calls for the answer now. A node at work ends its refinement and publishes what it has; an idle one points to its newest
    /// estimate.
    pub fn request(&self) -> RequestNumber {
        let requested = &self.mapping.controller.requested;
        let number = requested.fetch_add(1, SeqCst).wrapping_add(1);
        // The node says that it is idle, then looks at the requests; here it is the other way round. In the one order that all
        // sequentially consistent operations have, either it sees this request, or this sees that it is idle.
        if self.mapping.node.idle.load(SeqCst) != 0 {
            futex::wake_all(requested);
        }
        RequestNumber(number)
    }

    /// Waits for the answer to a request: the newest estimate, completed before the answer was given. `None`: there is none at all.
    pub fn wait_for_answer(
        &self,
        number: RequestNumber,
        timeout: Duration,
    ) -> Result<Option<CompletedEstimate>, SharedMemoryError> {
        self.wait("answer", &self.mapping.node.acknowledged, number.0, timeout)?;
        self.latest()
    }

    /// Waits until the count of completed estimates is beyond `after`, and returns it. The wrapping difference is the number of edges
    /// since: none is lost, however late the caller looks.
    pub fn wait_for_completion(&self, after: u32, timeout: Duration) -> Result<u32, SharedMemoryError> {
        self.wait("estimate", &self.mapping.node.completed, after.wrapping_add(1), timeout)
    }

    /// The newest estimate; `None` when there has been none yet.
    pub fn latest(&self) -> Result<Option<CompletedEstimate>, SharedMemoryError> {
        for attempt in 0..READS {
            match self.mapping.estimate.read() {
                Ok(estimate) => return Ok(estimate),
                Err(_) if attempt < READS_AT_ONCE => hint::spin_loop(),
                Err(_) => thread::sleep(BETWEEN_READS),
            }
        }
        Err(self.check_peer().err().unwrap_or(Problem::HalfWritten).of(&self.name))
    }

    /// What has been counted so far.
    pub fn counts(&self) -> Counts {
        // In this order no answer shows without its request.
        let acknowledged = self.mapping.node.acknowledged.load(Acquire);
        let requested = self.mapping.controller.requested.load(Acquire);
        Counts { acknowledged, requested, completed: self.mapping.node.completed.load(Acquire) }
    }

    /// The count `word` once it has reached `bound`.
    fn wait(&self, awaited: &'static str, word: &AtomicU32, bound: u32, timeout: Duration) -> Result<u32, SharedMemoryError> {
        let start = Instant::now();
        loop {
            // Looked at after the peer: what it did last still counts.
            let peer = if start.elapsed() < SPIN { Ok(()) } else { self.check_peer() };
            let value = word.load(Acquire);
            if has_reached(value, bound) {
                return Ok(value);
            }
            peer.map_err(|problem| problem.of(&self.name))?;
            let waited = start.elapsed();
            if waited >= timeout {
                return Err(Problem::TimedOut { awaited, timeout }.of(&self.name));
            }
            if waited < SPIN {
                hint::spin_loop();
            } else {
                futex::sleep(word, value, PEER_CHECK.min(timeout.saturating_sub(waited)));
            }
        }
    }

    fn check_identity(&self) -> Result<(), Problem> {
        let identity = &self.mapping.identity;
        let found = identity.magic.load(Acquire);
        if found != MAGIC {
            return Err(Problem::WrongMagic { found, expected: MAGIC });
        }
        let found = identity.version.load(Relaxed);
        if found != VERSION {
            return Err(Problem::WrongVersion { found, expected: VERSION });
        }
        let found = identity.size.load(Relaxed);
        if found != SIZE {
            return Err(Problem::WrongSize { found: found.into(), expected: SIZE });
        }
        Ok(())
    }

    /// Whether the node still serves the segment: it lives as long as nobody else can have the lock.
    fn check_peer(&self) -> Result<(), Problem> {
        let identity = &self.mapping.identity;
        let file = self.mapping.file();
        if identity.closed.load(Acquire) != 0 {
            Err(Problem::Closed)
        } else if flock(file, FlockOperation::NonBlockingLockShared).is_ok() {
            let _ = flock(file, FlockOperation::Unlock); // it goes with the file at the latest
            Err(Problem::OwnerDied { owner: identity.owner.load(Relaxed) })
        } else {
            Ok(())
        }
    }
}
