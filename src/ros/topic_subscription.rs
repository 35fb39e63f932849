//! The connections to the publishers of one topic.

use std::collections::HashSet;
use std::net::TcpStream;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use rosrust::api::Master;

use super::log::{Log, Throttle};
use super::sink::{Sink, Topic};
use super::tcpros::{LinkError, connect, read_message, request_topic};
use crate::anytime::clock::Clock;

/// Time between the end of a connection and the next attempt.
const RETRY_PERIOD: Duration = Duration::from_millis(500);
/// Who waits longer than this for a message of what the node lives on wants to know why.
const SILENCE: Duration = Duration::from_secs(5);

/// A topic, and a thread for each of its publishers. A link lives as long as its connection does: a master that has forgotten the
/// publisher does not end it.
pub(super) struct TopicSubscription {
    /// The topic's name in full.
    pub(super) topic: String,
    pub(super) node: String,
    pub(super) master: Arc<Master>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) log: Log,
    pub(super) sink: Mutex<Sink>,
    is_vital: bool,
    publishers: Mutex<Publishers>,
    refused: AtomicU64,
    /// Connections that there are.
    open: AtomicU64,
    silence: Mutex<Silence>,
}

/// How long there have been no messages.
#[derive(Default)]
struct Silence {
    /// Reading of the clock when the last message came, or other publishers.
    since: Duration,
    /// There have been messages.
    has_heard: bool,
    is_told: bool,
}

impl Silence {
    /// Somebody has spoken, or may be about to.
    fn end(&mut self, now: Duration, has_heard: bool) {
        *self = Self { since: now, has_heard: self.has_heard || has_heard, is_told: false };
    }

    /// Whether it has become too long; true once. A publisher that sent messages and has gone has ended: no warning.
    fn becomes_too_long(&mut self, now: Duration, is_published: bool) -> bool {
        let too_long = now.saturating_sub(self.since) >= SILENCE && (is_published || !self.has_heard);
        too_long && !std::mem::replace(&mut self.is_told, true)
    }
}

/// Nodes, by name.
#[derive(Default)]
struct Publishers {
    /// Those that the master knows.
    wanted: HashSet<String>,
    /// Those that have a thread.
    linked: HashSet<String>,
    /// Those that are connected.
    heard: HashSet<String>,
    throttle: Throttle,
}

impl TopicSubscription {
    pub(super) fn new(topic: String, node: &str, master: Arc<Master>, clock: Arc<dyn Clock>, log: Log, sink: Sink) -> Self {
        let (is_vital, sink) = (sink.topic.is_vital, Mutex::new(sink));
        let (publishers, refused, open) = (Mutex::default(), AtomicU64::new(0), AtomicU64::new(0));
        let silence = Mutex::new(Silence { since: clock.now(), ..Silence::default() });
        Self { topic, node: node.into(), master, clock, log, sink, is_vital, publishers, refused, open, silence }
    }

    /// Messages that were too long to be read.
    pub(super) fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    /// What is listened for.
    pub(super) fn wanted(&self) -> Topic {
        lock(&self.sink).topic
    }

    /// The nodes that it is connected to.
    pub(super) fn heard(&self) -> Vec<String> {
        lock(&self.publishers).heard.iter().cloned().collect()
    }

    /// Whether it is a needed topic without a publisher.
    pub(super) fn is_missed(&self) -> bool {
        self.is_vital && self.open.load(Ordering::Relaxed) == 0
    }

    /// Of a needed topic: its publishers, when they have sent nothing for too long.
    pub(super) fn falls_silent(&self) -> Option<Vec<String>> {
        let mut publishers: Vec<String> = lock(&self.publishers).wanted.iter().cloned().collect();
        publishers.sort_unstable();
        let is_silent = self.is_vital && lock(&self.silence).becomes_too_long(self.clock.now(), !publishers.is_empty());
        is_silent.then_some(publishers)
    }

    /// Takes the publishers that the master knows, and connects to the new ones. Returns whether they have changed.
    pub(super) fn set_publishers(self: &Arc<Self>, mut names: HashSet<String>) -> bool {
        names.remove(&self.node);
        let mut publishers = lock(&self.publishers);
        let has_changed = publishers.wanted != names;
        let new: Vec<String> = names.difference(&publishers.linked).cloned().collect();
        publishers.wanted = names;
        if has_changed {
            lock(&self.silence).end(self.clock.now(), false);
        }
        for publisher in new {
            let (subscription, name) = (Arc::clone(self), publisher.clone());
            match thread::Builder::new().name("link".into()).spawn(move || subscription.follow(&name)) {
                Ok(_) => drop(publishers.linked.insert(publisher)),
                Err(error) if publishers.throttle.allows("thread", self.clock.now()) => {
                    self.log.warn(&format!("topic {}: no connection to {publisher}: cannot start a thread: {error}", self.topic));
                }
                Err(_) => {}
            }
        }
        has_changed
    }

    /// Connects to `publisher`, again and again, as long as it is wanted.
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

    /// Receives from `publisher` until the connection ends: the number of messages, and what ended it.
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
        let fits = lock(&self.sink).accepts(&header, publisher, &self.topic, &self.log);
        self.open.fetch_add(1, Ordering::Relaxed);
        lock(&self.publishers).heard.insert(publisher.into());
        let problem = self.hear(stream, fits, publisher, messages);
        lock(&self.publishers).heard.remove(publisher);
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
                lock(&self.silence).end(arrival, true);
                lock(&self.sink).message(bytes, publisher, arrival);
            }
        }
    }

    /// Whether the thread of a publisher ends, as it is no longer wanted.
    fn is_done_with(&self, publisher: &str) -> bool {
        let mut publishers = lock(&self.publishers);
        let done = !publishers.wanted.contains(publisher);
        if done {
            publishers.linked.remove(publisher);
        }
        done
    }
}

/// What is locked here is consistent at every moment, even if a thread has panicked while it held the lock.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_told_once_and_not_of_who_has_ended() {
        let at = Duration::from_secs;
        let mut silence = Silence::default();
        assert!(!silence.becomes_too_long(at(4), false), "a normal start");
        assert!(silence.becomes_too_long(at(5), false) && !silence.becomes_too_long(at(6), false), "nobody has come");
        silence.end(at(7), false); // a publisher has come
        assert!(!silence.becomes_too_long(at(11), true) && silence.becomes_too_long(at(12), true), "it sends nothing");
        silence.end(at(13), true); // a message
        assert!(!silence.becomes_too_long(at(60), false), "it has ended");
        assert!(silence.becomes_too_long(at(60), true), "it goes on without a word");
    }
}
