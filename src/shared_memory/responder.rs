//! What the node uses: knows whether a scan is being worked on, and so how a request is to be answered.

use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::{Acquire, Release};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::error::{Problem, SharedMemoryError};
use super::estimate::SharedEstimate;
use super::server::Server;

/// The watcher need not wake up without a request: whoever ends it wakes it.
const WATCH: Duration = Duration::from_secs(3600);
/// Between attempts to wake the watcher at the end.
const BETWEEN_WAKES: Duration = Duration::from_micros(100);

/// Answers requests: those made while a scan is being worked on with that scan's estimate, others at once with the newest there is.
///
/// Dropping it closes the segment: all who wait learn of it, and its name is free again.
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

/// What the node is doing. Every answer is given with this locked, so that a request is either made before a scan is taken up, or
/// before its estimate is published, or after: there is nothing in between for it to fall into.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Activity {
    Idle,
    Working,
}

impl Responder {
    /// Creates the segment `name` for controllers of the same user, and serves it. A stale segment of that name gives way to the new
    /// one; one whose owner lives is an error.
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

    /// A scan is taken up: requests from now on call for its estimate. Those made before are answered with the newest one there is.
    pub fn begin(&self) {
        self.shared.answer(|activity| *activity = Activity::Working);
    }

    /// Whether a request waits for the estimate of the scan being worked on. For the refinement loop: two loads, no system call.
    pub fn is_requested(&self) -> bool {
        self.shared.server.requested() != self.shared.server.acknowledged()
    }

    /// An estimate is complete: readable from now on, counted once, and the answer to every request made before. Returns its number,
    /// whose parity is the value of the topic `icp_state`.
    pub fn publish(&self, estimate: &SharedEstimate) -> u32 {
        let number = self.shared.answer(|activity| {
            *activity = Activity::Idle;
            self.shared.server.complete(estimate)
        });
        self.shared.server.announce_completion();
        number
    }

    /// The scan taken up is put down without an estimate: requests made for it are answered with the newest one there is.
    pub fn abandon(&self) {
        self.shared.answer(|activity| *activity = Activity::Idle);
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        self.shared.closing.store(true, Release);
        let Some(watcher) = self.watcher.take() else { return };
        // Once is not enough: it may be on its way to sleep, having looked already.
        while !watcher.is_finished() {
            self.shared.server.interrupt_wait();
            thread::sleep(BETWEEN_WAKES);
        }
        let _ = watcher.join(); // it does not panic; if it had, the segment were to be closed all the same
    }
}

impl Shared {
    /// Changes what the node is doing, and answers all requests made before.
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
            self.server.await_request(seen, WATCH);
            // Looked at before the lock is taken: a request that comes later changes the word, and the next wait does not begin.
            seen = self.server.requested();
            let activity = self.lock();
            let answered = *activity == Activity::Idle && self.server.acknowledge();
            drop(activity);
            if answered {
                self.server.announce_answer();
            }
        }
    }

    /// The activity is whole at every moment, even if a thread should have died with the lock in its hand.
    fn lock(&self) -> MutexGuard<'_, Activity> {
        self.activity.lock().unwrap_or_else(PoisonError::into_inner)
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
        responder.begin(); // the watcher stays out of it
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
    fn an_abandoned_scan_leaves_no_request_behind() {
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
