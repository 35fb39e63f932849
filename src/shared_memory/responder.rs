//! The node's interface to the segment. It knows whether a scan is being processed, which decides how requests are answered.

use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::{Acquire, Release};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::error::{Problem, SharedMemoryError};
use super::estimate::SharedEstimate;
use super::server::Server;
use crate::parallel::lock;

/// Timeout of the watcher's sleep. It can be long, because both requests and the shutdown wake the watcher.
const WATCH_TIMEOUT: Duration = Duration::from_secs(3600);
/// Period of the attempts to wake the watcher at shutdown.
const WAKE_PERIOD: Duration = Duration::from_micros(100);

/// Answers requests. A request made while a scan is being processed is answered with the estimate of that scan, any other
/// immediately with the newest estimate.
///
/// Dropping it closes the segment: all waits end, and the name can be used again.
#[derive(Debug)]
pub struct Responder {
    shared: Arc<Shared>,
    watcher: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    server: Server,
    activity: Mutex<Activity>,
    closing: AtomicBool,
}

/// What the node is doing. Every answer is given with this locked. Thus each request is made either before the processing of a
/// scan begins, or before its estimate is published, or after that; there is no gap in which a request could be lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Activity {
    Idle,
    Working,
}

impl Responder {
    /// Creates the segment `name` for controllers of the same user, and serves it. A stale segment of that name is replaced. It
    /// is an error if the owner of an existing segment is alive.
    pub fn create(name: &str) -> Result<Self, SharedMemoryError> {
        let shared = Arc::new(Shared {
            server: Server::create(name)?,
            activity: Mutex::new(Activity::Idle),
            closing: AtomicBool::new(false),
        });
        let watched = Arc::clone(&shared);
        let watcher = thread::Builder::new()
            .name("interrupt".into())
            .spawn(move || watched.watch())
            .map_err(|source| Problem::System { action: "start the thread that answers requests", source }.of(name))?;
        Ok(Self { shared, watcher: Some(watcher) })
    }

    /// Name of the segment.
    pub fn name(&self) -> &str {
        self.shared.server.name()
    }

    /// The processing of a scan begins: requests from now on wait for its estimate. Earlier ones are answered with the newest
    /// estimate.
    pub fn begin(&self) {
        self.shared.answer(|activity| *activity = Activity::Working);
    }

    /// Whether a request waits for the estimate of the scan being processed. Cheap enough for the refinement loop: two loads, no
    /// system call.
    pub fn is_requested(&self) -> bool {
        self.shared.server.requested() != self.shared.server.acknowledged()
    }

    /// Publishes a completed estimate, which is the answer to every request made before. Returns its number, whose parity is the
    /// value of the topic `icp_state`.
    pub fn publish(&self, estimate: &SharedEstimate) -> u32 {
        let number = self.shared.answer(|activity| {
            *activity = Activity::Idle;
            self.shared.server.complete(estimate)
        });
        self.shared.server.announce_completion();
        number
    }

    /// The processing of a scan ends without an estimate: requests made meanwhile are answered with the newest earlier estimate.
    pub fn abandon(&self) {
        self.shared.answer(|activity| *activity = Activity::Idle);
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        self.shared.closing.store(true, Release);
        let Some(watcher) = self.watcher.take() else { return };
        // One wake-up may not be enough: the watcher may have checked `closing` already, but not sleep yet.
        while !watcher.is_finished() {
            self.shared.server.interrupt_wait();
            thread::sleep(WAKE_PERIOD);
        }
        let _ = watcher.join(); // it does not panic; if it had, the segment would have to be closed anyway
    }
}

impl Shared {
    /// Changes the activity of the node, and answers all requests made before.
    fn answer<T>(&self, change: impl FnOnce(&mut Activity) -> T) -> T {
        let mut activity = self.lock();
        let result = change(&mut activity);
        self.server.set_idle(*activity == Activity::Idle);
        let answered = self.server.acknowledge();
        drop(activity);
        if answered {
            self.server.announce_answer();
        }
        result
    }

    /// Answers requests while the node is idle, until the segment is closed.
    fn watch(&self) {
        let mut seen = 0;
        while !self.closing.load(Acquire) {
            self.server.wait_for_request(seen, WATCH_TIMEOUT);
            // Read before the lock is taken: a request made after this changes the word, so that the next wait returns at once.
            seen = self.server.requested();
            let activity = self.lock();
            let answered = *activity == Activity::Idle && self.server.acknowledge();
            drop(activity);
            if answered {
                self.server.announce_answer();
            }
        }
    }

    /// Locks the activity. It is valid at every moment, even if a thread has panicked while holding the lock.
    fn lock(&self) -> MutexGuard<'_, Activity> {
        lock(&self.activity)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering::Relaxed;

    use super::*;
    use crate::shared_memory::{Client, RequestNumber};

    #[test]
    fn counts_wrap_around() {
        let name = format!("/anytime_scan_matcher_wrap_{}", std::process::id());
        let responder = Responder::create(&name).unwrap();
        let segment = responder.shared.server.segment();
        responder.begin(); // so that the watcher does not answer
        let start = u32::MAX - 5;
        segment.controller.requested.store(start, Relaxed);
        segment.node.acknowledged.store(start, Relaxed);
        segment.node.completed.store(start, Relaxed);
        segment.estimate.sequence.store(start, Relaxed);
        let client = Client::open(&name).unwrap();
        for i in 1..=10_u32 {
            responder.begin();
            let requests = [client.request(), client.request()];
            assert_eq!(requests[1], RequestNumber(start.wrapping_add(2 * i)));
            assert!(!requests[0].is_answered_by(client.counts().acknowledged));
            let number = responder.publish(&SharedEstimate::default());
            assert_eq!(number, start.wrapping_add(i));
            for request in requests {
                let answer = client.wait_for_answer(request, Duration::from_secs(10)).unwrap();
                assert_eq!(answer.map(|answer| answer.number), Some(number));
            }
            assert_eq!(client.wait_for_completion(number.wrapping_sub(1), Duration::from_secs(10)).unwrap(), number);
        }
    }

    #[test]
    fn requests_for_an_abandoned_scan_are_answered() {
        let name = format!("/anytime_scan_matcher_abandon_{}", std::process::id());
        let responder = Responder::create(&name).unwrap();
        let client = Client::open(&name).unwrap();
        responder.begin();
        let request = client.request();
        assert!(responder.is_requested());
        responder.abandon();
        assert_eq!(client.wait_for_answer(request, Duration::from_secs(10)).unwrap(), None);
        assert_eq!(client.counts().completed, 0);
    }
}
