//! Everything that a node hears: its subscriptions, and who publishes them.
//!
//! rosrust's own subscribers take as much memory as a message announces, stand still when a publisher does not send its header, and
//! never return to one whose connection broke. So the connections are made here. rosrust answers for the node to the master and to
//! the other nodes; it keeps to itself when the master tells it of a new publisher, so who publishes is read from the master's state:
//! once a second, and more often while there is nobody to hear from. It is one small request for all topics together, and right again by
//! itself after a master has been replaced.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use rosrust::api::{Master, Ros, SystemState};

use super::NodeError;
use super::feed::Feed;
use super::inlet::Inlet;
use super::log::Log;
use super::master::{connect, resolved};
use crate::anytime::clock::Clock;

/// Time between two questions to the master who publishes, while there is nobody to hear from or somebody has just come or gone:
/// `rosbag play` gives its subscribers 200 ms to come.
const PERIOD: Duration = Duration::from_millis(50);
/// The same while everything is as it was: a question costs the machine a few milliseconds, which the answers to the scans would wait for.
const CALM_PERIOD: Duration = Duration::from_secs(1);
/// Who publishes several topics makes them known one after the other, and a launch file starts many nodes.
const SETTLING: Duration = Duration::from_secs(2);
/// A master of a large graph takes longer to answer. It is left alone for so many times as long.
const REST: u32 = 10;

/// A node's subscriptions. Dropping this ends them.
pub(super) struct Links<'a> {
    ros: &'a Ros,
    clock: Arc<dyn Clock>,
    log: Log,
    shared: Arc<Shared>,
    watcher: Thread,
}

struct Shared {
    master: Arc<Master>,
    feeds: Mutex<Vec<Arc<Feed>>>,
    closed: AtomicBool,
}

impl<'a> Links<'a> {
    /// Without subscriptions so far.
    pub(super) fn new(ros: &'a Ros, clock: &Arc<dyn Clock>, log: &Log) -> Result<Self, NodeError> {
        let master = Arc::new(connect(ros.name(), ros.uri())?);
        let shared = Arc::new(Shared { master, feeds: Mutex::default(), closed: AtomicBool::new(false) });
        let watched = Arc::clone(&shared);
        let watcher = thread::Builder::new()
            .name("links".into())
            .spawn(move || watched.watch())
            .map_err(|problem| NodeError::System { action: "start a thread", problem })?;
        Ok(Self { ros, clock: Arc::clone(clock), log: log.clone(), shared, watcher: watcher.thread().clone() })
    }

    /// Subscribes to the topic of `inlet`.
    pub(super) fn add(&self, inlet: Inlet) -> Result<(), NodeError> {
        let (topic, master) = (resolved(self.ros, inlet.topic.name)?, Arc::clone(&self.shared.master));
        let failed = |error| NodeError::ros(format!("subscribe to '{}'", inlet.topic.name), &error);
        master.register_subscriber(&topic, inlet.topic.message_type).map_err(failed)?;
        let feed = Feed::new(topic, self.ros.name(), master, Arc::clone(&self.clock), self.log.clone(), inlet);
        self.shared.feeds().push(Arc::new(feed));
        self.watcher.unpark();
        Ok(())
    }

    /// Messages that were too long to be read.
    pub(super) fn refused(&self) -> u64 {
        self.shared.feeds().iter().map(|feed| feed.refused()).sum()
    }
}

impl Drop for Links<'_> {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        for feed in self.shared.feeds().iter() {
            let _ = self.shared.master.unregister_subscriber(&feed.topic); // the master may be gone
        }
    }
}

impl Shared {
    fn watch(&self) {
        let mut changed = Instant::now();
        while !self.closed.load(Ordering::Relaxed) {
            let asked = Instant::now();
            let state = self.master.get_system_state();
            let took = asked.elapsed();
            if state.is_ok_and(|state| self.update(&state.into())) {
                changed = asked;
            }
            let is_calm = changed.elapsed() > SETTLING && !self.feeds().iter().any(|feed| feed.is_missed());
            let period = if is_calm { CALM_PERIOD } else { PERIOD };
            thread::park_timeout(period.max(REST * took));
        }
    }

    /// Answers whether somebody has come or gone.
    fn update(&self, state: &SystemState) -> bool {
        let mut has_changed = false;
        for feed in self.feeds().iter() {
            let entry = state.publishers.iter().find(|entry| entry.name == feed.topic);
            has_changed |= feed.set_publishers(entry.into_iter().flat_map(|entry| &entry.connections).cloned().collect());
        }
        has_changed
    }

    fn feeds(&self) -> MutexGuard<'_, Vec<Arc<Feed>>> {
        self.feeds.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
