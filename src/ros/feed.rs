//! The connections to the publishers of one topic.

use std::collections::HashSet;
use std::net::TcpStream;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use rosrust::api::Master;

use super::inlet::Inlet;
use super::log::{Log, Throttle};
use super::tcpros::{LinkError, connect, read_message, request_topic};
use crate::anytime::clock::Clock;

/// Time between the end of a connection and the next attempt.
const RETRY_PERIOD: Duration = Duration::from_millis(500);

/// A topic, and a thread for each of its publishers. A link lives as long as its connection does: a master that has forgotten the
/// publisher does not end it.
pub(super) struct Feed {
    /// The topic's name in full.
    pub(super) topic: String,
    pub(super) node: String,
    pub(super) master: Arc<Master>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) log: Log,
    pub(super) inlet: Mutex<Inlet>,
    is_vital: bool,
    publishers: Mutex<Publishers>,
    refused: AtomicU64,
    /// Connections that there are.
    open: AtomicU64,
}

/// Nodes, by name.
#[derive(Default)]
struct Publishers {
    /// Those that the master knows.
    wanted: HashSet<String>,
    /// Those that have a thread.
    linked: HashSet<String>,
    throttle: Throttle,
}

impl Feed {
    pub(super) fn new(topic: String, node: &str, master: Arc<Master>, clock: Arc<dyn Clock>, log: Log, inlet: Inlet) -> Self {
        let (is_vital, inlet) = (inlet.topic.is_vital, Mutex::new(inlet));
        let (publishers, refused, open) = (Mutex::default(), AtomicU64::new(0), AtomicU64::new(0));
        Self { topic, node: node.into(), master, clock, log, inlet, is_vital, publishers, refused, open }
    }

    /// Messages that were too long to be read.
    pub(super) fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    /// Whether there is nobody to hear from of what the node lives on.
    pub(super) fn is_missed(&self) -> bool {
        self.is_vital && self.open.load(Ordering::Relaxed) == 0
    }

    /// Takes the master's word for who publishes: links to those that are new. Answers whether these are others than before.
    pub(super) fn set_publishers(self: &Arc<Self>, mut names: HashSet<String>) -> bool {
        names.remove(&self.node);
        let mut publishers = lock(&self.publishers);
        let has_changed = publishers.wanted != names;
        let new: Vec<String> = names.difference(&publishers.linked).cloned().collect();
        publishers.wanted = names;
        for publisher in new {
            let (feed, name) = (Arc::clone(self), publisher.clone());
            match thread::Builder::new().name("link".into()).spawn(move || feed.follow(&name)) {
                Ok(_) => drop(publishers.linked.insert(publisher)),
                Err(error) if publishers.throttle.allows("thread", self.clock.now()) => {
                    self.log.warn(&format!("topic {}: no connection to {publisher}: cannot start a thread: {error}", self.topic));
                }
                Err(_) => {}
            }
        }
        has_changed
    }

    /// Links to `publisher`, again and again, for as long as it is wanted.
    fn follow(&self, publisher: &str) {
        let (mut throttle, mut told) = (Throttle::default(), None);
        loop {
            let (messages, problem) = self.link(publisher);
            let problem = problem.to_string();
            thread::sleep(RETRY_PERIOD);
            if self.is_done_with(publisher) {
                return;
            }
            let news = messages > 0 || told.as_ref() != Some(&problem);
            if news && throttle.allows("link", self.clock.now()) {
                self.log.warn(&format!("topic {}: no connection to {publisher}: {problem}: trying again", self.topic));
                told = Some(problem);
            }
        }
    }

    /// Hears `publisher` to the end: the number of messages, and what ended it.
    fn link(&self, publisher: &str) -> (u64, LinkError) {
        let mut messages = 0;
        let problem = match self.receive(publisher, &mut messages) {
            Err(problem) => problem,
            Ok(never) => match never {},
        };
        self.refused.fetch_add(u64::from(matches!(problem, LinkError::TooLong(_))), Ordering::Relaxed);
        (messages, problem)
    }

    fn receive(&self, publisher: &str, messages: &mut u64) -> Result<std::convert::Infallible, LinkError> {
        let uri = self.master.lookup_node(publisher).map_err(|error| LinkError::Unknown(error.to_string()))?;
        let address = request_topic(&uri, &self.node, &self.topic)?;
        let (stream, header) = connect(&address, &self.node, &self.topic)?;
        let fits = lock(&self.inlet).accepts(&header, publisher, &self.topic, &self.log);
        self.open.fetch_add(1, Ordering::Relaxed);
        let problem = self.hear(stream, fits, publisher, messages);
        self.open.fetch_sub(1, Ordering::Relaxed);
        problem
    }

    /// Takes messages from a connection until it breaks; those of the wrong type are only counted.
    fn hear(
        &self,
        mut stream: TcpStream,
        fits: bool,
        publisher: &str,
        messages: &mut u64,
    ) -> Result<std::convert::Infallible, LinkError> {
        loop {
            let bytes = read_message(&mut stream)?;
            let arrival = self.clock.now();
            *messages += 1;
            if fits {
                lock(&self.inlet).message(bytes, publisher, arrival);
            }
        }
    }

    /// Gives the thread of a publisher up that nobody wants any more.
    fn is_done_with(&self, publisher: &str) -> bool {
        let mut publishers = lock(&self.publishers);
        let done = !publishers.wanted.contains(publisher);
        if done {
            publishers.linked.remove(publisher);
        }
        done
    }
}

/// What is locked here is whole at every moment, even if a thread should have died with the lock in its hand.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
