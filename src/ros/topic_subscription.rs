//! The connections to the publishers of one topic.

use std::collections::HashSet;
use std::net::TcpStream;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use rosrust::api::Master;

use super::log::{Log, Throttle};
use super::sink::{Sink, Topic};
use super::tcpros::{LinkError, connect, read_message, request_topic};
use super::threads::spawn;
use crate::anytime::clock::Clock;
use crate::parallel::lock;

/// Time between the end of a connection and the next attempt to connect.
const RETRY_PERIOD: Duration = Duration::from_millis(500);
/// Time without messages on a required topic after which a warning is logged.
pub(super) const SILENCE_TIMEOUT: Duration = Duration::from_secs(5);

/// The subscription to a topic, with a thread for each publisher. A link lasts as long as its TCP connection, even if the master
/// no longer knows the publisher.
pub(super) struct TopicSubscription {
    /// Fully resolved name of the topic.
    pub(super) topic: String,
    pub(super) node: String,
    pub(super) master: Arc<Master>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) log: Log,
    pub(super) sink: Mutex<Sink>,
    is_required: bool,
    publishers: Mutex<Publishers>,
    oversized: AtomicU64,
    /// Number of open connections.
    open: AtomicU64,
    silence: Mutex<Silence>,
}

/// Detects that no messages arrive.
#[derive(Default)]
struct Silence {
    /// Time of the last message or of the last change of publishers.
    since: Duration,
    /// Whether any message has arrived so far.
    has_received: bool,
    /// Whether the warning has been logged.
    is_logged: bool,
}

impl Silence {
    /// Restarts the timeout, because a message arrived or the publishers changed.
    fn restart(&mut self, now: Duration, has_received: bool) {
        *self = Self { since: now, has_received: self.has_received || has_received, is_logged: false };
    }

    /// Returns `true` once when the timeout expires. There is no warning if a publisher sent messages and then left normally.
    fn expires(&mut self, now: Duration, is_published: bool) -> bool {
        let too_long = now.saturating_sub(self.since) >= SILENCE_TIMEOUT && (is_published || !self.has_received);
        too_long && !std::mem::replace(&mut self.is_logged, true)
    }
}

/// Names of publishing nodes.
#[derive(Default)]
struct Publishers {
    /// Publishers that the master knows.
    known: HashSet<String>,
    /// Publishers that have a thread.
    with_thread: HashSet<String>,
    /// Publishers that are connected.
    connected: HashSet<String>,
    throttle: Throttle,
}

impl TopicSubscription {
    pub(super) fn new(topic: String, node: &str, master: Arc<Master>, clock: Arc<dyn Clock>, log: Log, sink: Sink) -> Self {
        let (is_required, sink) = (sink.topic.is_required, Mutex::new(sink));
        let (publishers, oversized, open) = (Mutex::default(), AtomicU64::new(0), AtomicU64::new(0));
        let silence = Mutex::new(Silence { since: clock.now(), ..Silence::default() });
        Self { topic, node: node.into(), master, clock, log, sink, is_required, publishers, oversized, open, silence }
    }

    /// Number of messages that exceeded the size limit.
    pub(super) fn oversized(&self) -> u64 {
        self.oversized.load(Ordering::Relaxed)
    }

    /// The topic as the node declares it.
    pub(super) fn declared_topic(&self) -> Topic {
        lock(&self.sink).topic
    }

    /// The connected publishers.
    pub(super) fn connected(&self) -> Vec<String> {
        lock(&self.publishers).connected.iter().cloned().collect()
    }

    /// Whether this is a required topic without a connection.
    pub(super) fn lacks_publisher(&self) -> bool {
        self.is_required && self.open.load(Ordering::Relaxed) == 0
    }

    /// If a required topic has just become silent: the names of its publishers.
    pub(super) fn newly_silent(&self) -> Option<Vec<String>> {
        let mut publishers: Vec<String> = lock(&self.publishers).known.iter().cloned().collect();
        publishers.sort_unstable();
        let is_silent = self.is_required && lock(&self.silence).expires(self.clock.now(), !publishers.is_empty());
        is_silent.then_some(publishers)
    }

    /// Sets the publishers that the master knows and connects to the new ones. Returns whether they have changed.
    pub(super) fn set_publishers(self: &Arc<Self>, mut names: HashSet<String>) -> bool {
        names.remove(&self.node);
        let mut publishers = lock(&self.publishers);
        let has_changed = publishers.known != names;
        let new: Vec<String> = names.difference(&publishers.with_thread).cloned().collect();
        publishers.known = names;
        if has_changed {
            lock(&self.silence).restart(self.clock.now(), false);
        }
        for publisher in new {
            let (subscription, name) = (Arc::clone(self), publisher.clone());
            match spawn("link", move || subscription.keep_connected(&name)) {
                Ok(_) => drop(publishers.with_thread.insert(publisher)),
                Err(error) if publishers.throttle.allows("thread", self.clock.now()) => {
                    self.log.warn(&format!("topic {}: no connection to {publisher}: {error}", self.topic));
                }
                Err(_) => {}
            }
        }
        has_changed
    }

    /// Connects to `publisher`, and reconnects for as long as the master knows it.
    fn keep_connected(&self, publisher: &str) {
        let (mut throttle, mut logged) = (Throttle::default(), None);
        loop {
            let (messages, problem) = self.connect_once(publisher);
            let problem = problem.to_string();
            thread::sleep(RETRY_PERIOD);
            if self.forget_if_gone(publisher) {
                return;
            }
            let is_new = messages > 0 || logged.as_ref() != Some(&problem);
            if is_new && throttle.allows("link", self.clock.now()) {
                self.log.warn(&format!("topic {}: no connection to {publisher}: {problem}; trying again", self.topic));
                logged = Some(problem);
            }
        }
    }

    /// Receives from `publisher` until the connection ends. Returns the number of messages and the reason for the end.
    fn connect_once(&self, publisher: &str) -> (u64, LinkError) {
        let mut messages = 0;
        let problem = match self.receive(publisher, &mut messages) {
            Err(problem) => problem,
            Ok(never) => match never {},
        };
        self.oversized.fetch_add(u64::from(matches!(problem, LinkError::Oversized(_))), Ordering::Relaxed);
        (messages, problem)
    }

    fn receive(&self, publisher: &str, messages: &mut u64) -> Result<std::convert::Infallible, LinkError> {
        let uri = self.master.lookup_node(publisher).map_err(|error| LinkError::Unknown(error.to_string()))?;
        let address = request_topic(&uri, &self.node, &self.topic)?;
        let (stream, header) = connect(&address, &self.node, &self.topic)?;
        let is_right_type = lock(&self.sink).accepts(&header, publisher, &self.topic, &self.log);
        self.open.fetch_add(1, Ordering::Relaxed);
        lock(&self.publishers).connected.insert(publisher.into());
        let problem = self.read_messages(stream, is_right_type, publisher, messages);
        lock(&self.publishers).connected.remove(publisher);
        self.open.fetch_sub(1, Ordering::Relaxed);
        problem
    }

    /// Reads messages from a connection until it breaks. Messages of the wrong type are only counted.
    fn read_messages(
        &self,
        mut stream: TcpStream,
        is_right_type: bool,
        publisher: &str,
        messages: &mut u64,
    ) -> Result<std::convert::Infallible, LinkError> {
        loop {
            let bytes = read_message(&mut stream)?;
            let arrival = self.clock.now();
            *messages += 1;
            if is_right_type {
                lock(&self.silence).restart(arrival, true);
                lock(&self.sink).message(bytes, publisher, arrival);
            }
        }
    }

    /// Forgets the thread of a publisher that the master no longer knows. Returns whether the thread must end.
    fn forget_if_gone(&self, publisher: &str) -> bool {
        let mut publishers = lock(&self.publishers);
        let is_gone = !publishers.known.contains(publisher);
        if is_gone {
            publishers.with_thread.remove(publisher);
        }
        is_gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_reported_once_and_not_after_a_publisher_has_left() {
        let at = Duration::from_secs;
        let mut silence = Silence::default();
        assert!(!silence.expires(at(4), false), "a normal start");
        assert!(silence.expires(at(5), false) && !silence.expires(at(6), false), "there is no publisher");
        silence.restart(at(7), false); // a publisher appears
        assert!(!silence.expires(at(11), true) && silence.expires(at(12), true), "it sends nothing");
        silence.restart(at(13), true); // a message
        assert!(!silence.expires(at(60), false), "the publisher has left");
        assert!(silence.expires(at(60), true), "the publisher is there but sends nothing");
    }
}
