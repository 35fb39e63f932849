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

/// Time for which a wait polls the memory before it sleeps: about as long as waking up takes. A longer time would not help if the
/// node runs on the same core, because it can only answer once the controller sleeps.
pub const SPIN: Duration = Duration::from_micros(10);

/// Period at which a sleeping controller checks that the node is still alive. (A node that closes the segment wakes all waiters
/// at once.)
pub const PEER_CHECK: Duration = Duration::from_millis(50);

/// Number of attempts to read a consistent estimate without a pause.
const READS_WITHOUT_PAUSE: u32 = 100;
/// Total number of attempts; those after the first [`READS_WITHOUT_PAUSE`] are [`READ_PAUSE`] apart.
const MAX_READS: u32 = 600;
/// Pause between attempts to read: lets a node continue that a controller of higher priority has preempted while it was writing.
const READ_PAUSE: Duration = Duration::from_micros(100);

/// The number of a request, which identifies its answer. Numbers wrap around.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RequestNumber(pub u32);

impl RequestNumber {
    /// Whether a node that has answered all requests up to `acknowledged` has answered this one.
    pub const fn is_answered_by(self, acknowledged: u32) -> bool {
        has_reached(acknowledged, self.0)
    }
}

/// Whether a count that wraps around has reached `bound`. Correct as long as they are less than 2^31 apart.
const fn has_reached(count: u32, bound: u32) -> bool {
    count.wrapping_sub(bound) < 1 << 31
}

/// The counts so far. All counts wrap around.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Number of the last answered request; all earlier ones are answered, too.
    pub acknowledged: u32,
    /// Number of requests made.
    pub requested: u32,
    /// Number of estimates completed. Its parity is the value of the topic `icp_state`.
    pub completed: u32,
}

/// A controller's access to a segment. All methods may be called from several threads at once.
#[derive(Debug)]
pub struct Client {
    mapping: Mapping,
    name: String,
}

impl Client {
    /// Opens the segment of a running node.
    pub fn open(name: &str) -> Result<Self, SharedMemoryError> {
        let mapping = name::open(name, OFlags::empty()).and_then(Mapping::new).map_err(|problem| problem.of(name))?;
        let client = Self { mapping, name: name.to_owned() };
        client.check_identity().and_then(|()| client.check_peer()).map_err(|problem| problem.of(name))?;
        Ok(client)
    }

    /// Requests an answer now. A node that is processing a scan ends the refinement and publishes the estimate it has; the answer
    /// of an idle node is its newest estimate.
    pub fn request(&self) -> RequestNumber {
        let requested = &self.mapping.controller.requested;
        let number = requested.fetch_add(1, SeqCst).wrapping_add(1);
        // The node first sets `idle`, then reads the requests; this side first adds a request, then reads `idle`. All
        // sequentially consistent operations have one total order, so either the node sees this request, or this side sees that
        // the node is idle.
        if self.mapping.node.idle.load(SeqCst) != 0 {
            futex::wake_all(requested);
        }
        RequestNumber(number)
    }

    /// Waits for the answer to a request: the newest estimate, completed before the answer was given. `None` if there is no
    /// estimate yet.
    pub fn wait_for_answer(
        &self,
        number: RequestNumber,
        timeout: Duration,
    ) -> Result<Option<CompletedEstimate>, SharedMemoryError> {
        self.wait("answer", &self.mapping.node.acknowledged, number.0, timeout)?;
        self.latest()
    }

    /// Waits until the count of completed estimates is greater than `after`, and returns it. The wrapping difference is the
    /// number of estimates completed since; none is missed, however late the caller checks.
    pub fn wait_for_completion(&self, after: u32, timeout: Duration) -> Result<u32, SharedMemoryError> {
        self.wait("estimate", &self.mapping.node.completed, after.wrapping_add(1), timeout)
    }

    /// The newest estimate; `None` if there is none yet.
    pub fn latest(&self) -> Result<Option<CompletedEstimate>, SharedMemoryError> {
        for attempt in 0..MAX_READS {
            match self.mapping.estimate.read() {
                Ok(estimate) => return Ok(estimate),
                Err(_) if attempt < READS_WITHOUT_PAUSE => hint::spin_loop(),
                Err(_) => thread::sleep(READ_PAUSE),
            }
        }
        Err(self.check_peer().err().unwrap_or(Problem::HalfWritten).of(&self.name))
    }

    /// The counts so far.
    pub fn counts(&self) -> Counts {
        // This order ensures that `acknowledged` is never ahead of `requested`.
        let acknowledged = self.mapping.node.acknowledged.load(Acquire);
        let requested = self.mapping.controller.requested.load(Acquire);
        Counts { acknowledged, requested, completed: self.mapping.node.completed.load(Acquire) }
    }

    /// Waits until the count `word` has reached `bound`, and returns it.
    fn wait(&self, awaited: &'static str, word: &AtomicU32, bound: u32, timeout: Duration) -> Result<u32, SharedMemoryError> {
        let start = Instant::now();
        loop {
            // Read after the check of the peer, so that the last count of a node that has just died is not missed.
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

    /// Checks that the node still serves the segment: it is alive as long as no one else can get the lock.
    fn check_peer(&self) -> Result<(), Problem> {
        let identity = &self.mapping.identity;
        let file = self.mapping.file();
        if identity.closed.load(Acquire) != 0 {
            Err(Problem::Closed)
        } else if flock(file, FlockOperation::NonBlockingLockShared).is_ok() {
            let _ = flock(file, FlockOperation::Unlock); // at the latest, closing the file releases it
            Err(Problem::OwnerDied { owner: identity.owner.load(Relaxed) })
        } else {
            Ok(())
        }
    }
}
