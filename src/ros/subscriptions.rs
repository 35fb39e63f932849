//! The subscriptions of a node, and who publishes them.
//!
//! rosrust's own subscribers take as much memory as a message announces, stand still when a publisher does not send its header, and
//! never return to one whose connection broke. So the connections are made here. rosrust answers for the node to the master and to
//! the other nodes. Who publishes is read from the master's state: when the master tells of somebody new (`node_api`), once a second,
//! and more often while there is nobody to hear from. It is one small request for all topics together, and right again by
//! itself after a master has been replaced.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use rosrust::api::{Master, Ros, SystemState};

use super::NodeError;
use super::log::Log;
use super::master::{connect, resolved};
use super::node_api::{self, Inputs};
use super::sink::{RawMessage, Sink, Topic};
use super::topic_subscription::TopicSubscription;
use crate::anytime::clock::Clock;

/// Time between two polls of the master for publishers, while a needed topic has none or publishers have just changed:
/// `rosbag play` gives its subscribers 200 ms to come.
const PERIOD: Duration = Duration::from_millis(50);
/// The same while nothing changes: a poll costs a few milliseconds, which would delay the answers to scans.
const CALM_PERIOD: Duration = Duration::from_secs(1);
/// Who publishes several topics makes them known one after the other, and a launch file starts many nodes.
const SETTLING: Duration = Duration::from_secs(2);
/// A master of a large graph takes longer to answer. It is left alone for so many times as long.
const REST: u32 = 10;

/// A node's subscriptions. Dropping this ends them.
pub(super) struct Subscriptions<'a> {
    ros: &'a Ros,
    clock: Arc<dyn Clock>,
    log: Log,
    shared: Arc<Shared>,
}

struct Shared {
    master: Arc<Master>,
    subscriptions: Mutex<Vec<Arc<TopicSubscription>>>,
    closed: AtomicBool,
    watcher: OnceLock<Thread>,
}

impl Inputs for Shared {
    fn topics(&self) -> Vec<(String, String)> {
        self.subscriptions()
            .iter()
            .map(|subscription| (subscription.topic.clone(), subscription.wanted().message_type.into()))
            .collect()
    }

    fn connections(&self) -> Vec<(String, String)> {
        let of_subscription = |subscription: &Arc<TopicSubscription>| {
            subscription.heard().into_iter().map(|node| (subscription.topic.clone(), node)).collect::<Vec<_>>()
        };
        self.subscriptions().iter().flat_map(of_subscription).collect()
    }

    fn look_again(&self) {
        self.watcher.get().inspect(|watcher| watcher.unpark());
    }
}

impl<'a> Subscriptions<'a> {
    /// Without subscriptions so far.
    pub(super) fn new(ros: &'a Ros, clock: &Arc<dyn Clock>, log: &Log) -> Result<Self, NodeError> {
        let master = Arc::new(connect(ros.name(), ros.uri())?);
        let shared = Arc::new(Shared {
            master,
            subscriptions: Mutex::default(),
            closed: AtomicBool::new(false),
            watcher: OnceLock::new(),
        });
        let watched = Arc::clone(&shared);
        let watcher = thread::Builder::new()
            .name("subscriptions".into())
            .spawn(move || watched.watch())
            .map_err(|problem| NodeError::System { action: "start a thread", problem })?;
        let _ = shared.watcher.set(watcher.thread().clone());
        node_api::set_inputs(&shared);
        Ok(Self { ros, clock: Arc::clone(clock), log: log.clone(), shared })
    }

    /// Subscribes to `topic`, whoever publishes it, except the node itself; what comes goes to `receive`, which must not be slow.
    pub(super) fn listen(&self, topic: Topic, receive: impl FnMut(RawMessage) + Send + 'static) -> Result<(), NodeError> {
        let sink = Sink::new(topic, receive);
        let (topic, master) = (resolved(self.ros, sink.topic.name)?, Arc::clone(&self.shared.master));
        let failed = |error| NodeError::ros(format!("subscribe to '{}'", sink.topic.name), &error);
        master.register_subscriber(&topic, sink.topic.message_type).map_err(failed)?;
        let subscription =
            TopicSubscription::new(topic, self.ros.name(), master, Arc::clone(&self.clock), self.log.clone(), sink);
        self.shared.subscriptions().push(Arc::new(subscription));
        self.shared.look_again();
        Ok(())
    }

    /// Messages that were too long to be read.
    pub(super) fn refused(&self) -> u64 {
        self.shared.subscriptions().iter().map(|subscription| subscription.refused()).sum()
    }
}

impl Drop for Subscriptions<'_> {
    fn drop(&mut self) {
        self.shared.closed.store(true, Ordering::Relaxed);
        for subscription in self.shared.subscriptions().iter() {
            let _ = self.shared.master.unregister_subscriber(&subscription.topic); // the master may be gone
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
            self.tell_silence();
            let is_calm =
                changed.elapsed() > SETTLING && !self.subscriptions().iter().any(|subscription| subscription.is_missed());
            let period = if is_calm { CALM_PERIOD } else { PERIOD };
            thread::park_timeout(period.max(REST * took));
        }
    }

    /// Returns whether publishers have changed.
    fn update(&self, state: &SystemState) -> bool {
        let mut has_changed = false;
        for subscription in self.subscriptions().iter() {
            let entry = state.publishers.iter().find(|entry| entry.name == subscription.topic);
            has_changed |= subscription.set_publishers(entry.into_iter().flat_map(|entry| &entry.connections).cloned().collect());
        }
        has_changed
    }

    /// Warns of topics without messages, and lists other topics of the same type.
    fn tell_silence(&self) {
        let subscriptions: Vec<Arc<TopicSubscription>> = self.subscriptions().iter().cloned().collect();
        for subscription in subscriptions {
            let Some(publishers) = subscription.falls_silent() else { continue };
            let Topic { name, message_type, .. } = subscription.wanted();
            let published = self.master.get_published_topics("").unwrap_or_default();
            let others: Vec<String> = published
                .into_iter()
                .filter(|(topic, published)| published == message_type && *topic != subscription.topic)
                .map(|(topic, _)| topic)
                .collect();
            let text = silence(name, message_type, &publishers, &others);
            subscription.log.warn(&format!("topic {}: no message for 5 s: {text}", subscription.topic));
        }
    }

    fn subscriptions(&self) -> MutexGuard<'_, Vec<Arc<TopicSubscription>>> {
        self.subscriptions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Why nothing may come, and what could help. `name`: the topic before remapping; `others`: topics of its type.
fn silence(name: &str, message_type: &str, publishers: &[String], others: &[String]) -> String {
    let who =
        if publishers.is_empty() { "nobody publishes it".into() } else { format!("{} sends nothing", publishers.join(", ")) };
    let remedy = match others {
        [] => format!("there is no other topic of {message_type}"),
        [first, ..] => format!("other topics of {message_type}: {}; to take one: {name}:={first}", others.join(", ")),
    };
    format!("{who}; {remedy}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_names_publishers_and_other_topics() {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let lonely = silence("scan", "sensor_msgs/LaserScan", &[], &[]);
        assert_eq!(lonely, "nobody publishes it; there is no other topic of sensor_msgs/LaserScan");
        let elsewhere = silence("scan", "sensor_msgs/LaserScan", &names(&["/laser"]), &names(&["/front", "/rear"]));
        assert_eq!(
            elsewhere,
            "/laser sends nothing; other topics of sensor_msgs/LaserScan: /front, /rear; to take one: scan:=/front"
        );
    }
}
