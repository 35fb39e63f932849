//! The subscriptions of a node, and the discovery of their publishers.
//!
//! rosrust's own subscribers allocate as much memory as a message header announces, block if a publisher does not send its
//! header, and never reconnect after a connection broke. So the connections are made here; rosrust still runs the node's XML-RPC
//! interface. The publishers are read from the master's system state: after a `publisherUpdate` (`node_api`), once a second, and
//! more often while a required topic has no publisher. That is one small request for all topics together, and it stays correct
//! after the master has been replaced.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use rosrust::api::{Master, Ros, SystemState};

use super::NodeError;
use super::log::Log;
use super::master::{connect, resolved};
use super::node_api::{self, SubscriptionInfo};
use super::sink::{RawMessage, Sink, Topic};
use super::threads::spawn;
use super::topic_subscription::{SILENCE_TIMEOUT, TopicSubscription};
use crate::anytime::clock::Clock;
use crate::parallel::lock;

/// Time between two polls of the master while a required topic has no publisher or publishers have just changed: `rosbag play`
/// gives its subscribers 200 ms to connect.
const FAST_POLL_PERIOD: Duration = Duration::from_millis(50);
/// Time between two polls while nothing changes: a poll costs a few milliseconds, which would delay answers to scans.
const POLL_PERIOD: Duration = Duration::from_secs(1);
/// Time of fast polling after a change: a node advertises its topics one after the other, and a launch file starts many nodes.
const SETTLING_TIME: Duration = Duration::from_secs(2);
/// Minimum pause between two polls, as a multiple of the master's response time: that grows with the size of the graph.
const MIN_PAUSE_FACTOR: u32 = 10;

/// The subscriptions of a node. Dropping this ends them.
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
    poller: OnceLock<Thread>,
}

impl SubscriptionInfo for Shared {
    fn topics(&self) -> Vec<(String, String)> {
        self.subscriptions()
            .iter()
            .map(|subscription| (subscription.topic.clone(), subscription.declared_topic().message_type.into()))
            .collect()
    }

    fn connections(&self) -> Vec<(String, String)> {
        let of_subscription = |subscription: &Arc<TopicSubscription>| {
            subscription.connected().into_iter().map(|node| (subscription.topic.clone(), node)).collect::<Vec<_>>()
        };
        self.subscriptions().iter().flat_map(of_subscription).collect()
    }

    fn on_publisher_update(&self) {
        self.poller.get().inspect(|poller| poller.unpark());
    }
}

impl<'a> Subscriptions<'a> {
    /// Starts without subscriptions.
    pub(super) fn new(ros: &'a Ros, clock: &Arc<dyn Clock>, log: &Log) -> Result<Self, NodeError> {
        let master = Arc::new(connect(ros.name(), ros.uri())?);
        let shared =
            Arc::new(Shared { master, subscriptions: Mutex::default(), closed: AtomicBool::new(false), poller: OnceLock::new() });
        let polled = Arc::clone(&shared);
        let poller = spawn("subscriptions", move || polled.poll_master())?;
        let _ = shared.poller.set(poller.thread().clone());
        node_api::set_subscription_info(&shared);
        Ok(Self { ros, clock: Arc::clone(clock), log: log.clone(), shared })
    }

    /// Subscribes to `topic` of every publisher except the node itself. Each message is passed to `receive`, which must be fast.
    pub(super) fn subscribe(&self, topic: Topic, receive: impl FnMut(RawMessage) + Send + 'static) -> Result<(), NodeError> {
        let sink = Sink::new(topic, receive);
        let (topic, master) = (resolved(self.ros, sink.topic.name)?, Arc::clone(&self.shared.master));
        let failed = |error| NodeError::ros(format!("subscribe to '{}'", sink.topic.name), &error);
        master.register_subscriber(&topic, sink.topic.message_type).map_err(failed)?;
        let subscription =
            TopicSubscription::new(topic, self.ros.name(), master, Arc::clone(&self.clock), self.log.clone(), sink);
        self.shared.subscriptions().push(Arc::new(subscription));
        self.shared.on_publisher_update();
        Ok(())
    }

    /// Number of messages that exceeded the size limit.
    pub(super) fn oversized(&self) -> u64 {
        self.shared.subscriptions().iter().map(|subscription| subscription.oversized()).sum()
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
    fn poll_master(&self) {
        let mut last_change = Instant::now();
        while !self.closed.load(Ordering::Relaxed) {
            let start = Instant::now();
            let state = self.master.get_system_state();
            let response_time = start.elapsed();
            if state.is_ok_and(|state| self.update(&state.into())) {
                last_change = start;
            }
            self.warn_of_silent_topics();
            let is_calm = last_change.elapsed() > SETTLING_TIME
                && !self.subscriptions().iter().any(|subscription| subscription.lacks_publisher());
            let period = if is_calm { POLL_PERIOD } else { FAST_POLL_PERIOD };
            thread::park_timeout(period.max(MIN_PAUSE_FACTOR * response_time));
        }
    }

    /// Updates the publishers of all topics. Returns whether any have changed.
    fn update(&self, state: &SystemState) -> bool {
        let mut has_changed = false;
        for subscription in self.subscriptions().iter() {
            let entry = state.publishers.iter().find(|entry| entry.name == subscription.topic);
            has_changed |= subscription.set_publishers(entry.into_iter().flat_map(|entry| &entry.connections).cloned().collect());
        }
        has_changed
    }

    /// Warns of required topics without messages, and lists other topics of the same type.
    fn warn_of_silent_topics(&self) {
        let subscriptions: Vec<Arc<TopicSubscription>> = self.subscriptions().iter().cloned().collect();
        for subscription in subscriptions {
            let Some(publishers) = subscription.newly_silent() else { continue };
            let Topic { name, message_type, .. } = subscription.declared_topic();
            let published = self.master.get_published_topics("").unwrap_or_default();
            let others: Vec<String> = published
                .into_iter()
                .filter(|(topic, published)| published == message_type && *topic != subscription.topic)
                .map(|(topic, _)| topic)
                .collect();
            let text = silence_warning(name, message_type, &publishers, &others);
            subscription.log.warn(&format!("topic {}: {text}", subscription.topic));
        }
    }

    fn subscriptions(&self) -> MutexGuard<'_, Vec<Arc<TopicSubscription>>> {
        lock(&self.subscriptions)
    }
}

/// The warning of a silent topic, with the likely reason and the remedy. `name`: the topic before remapping; `others`: published topics of its
/// type.
fn silence_warning(name: &str, message_type: &str, publishers: &[String], others: &[String]) -> String {
    let cause =
        if publishers.is_empty() { "it has no publisher".into() } else { format!("{} sends nothing", publishers.join(", ")) };
    let remedy = match others {
        [] => format!("no other topic has the type {message_type}"),
        [first, ..] => format!("other topics of {message_type}: {}; to use one, remap: {name}:={first}", others.join(", ")),
    };
    format!("no message for {} s: {cause}; {remedy}", SILENCE_TIMEOUT.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_warning_names_the_timeout_publishers_and_other_topics() {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let start = format!("no message for {} s: ", SILENCE_TIMEOUT.as_secs());
        let unpublished = silence_warning("scan", "sensor_msgs/LaserScan", &[], &[]);
        assert_eq!(unpublished, start.clone() + "it has no publisher; no other topic has the type sensor_msgs/LaserScan");
        let silent = silence_warning("scan", "sensor_msgs/LaserScan", &names(&["/laser"]), &names(&["/front", "/rear"]));
        assert_eq!(
            silent,
            start + "/laser sends nothing; other topics of sensor_msgs/LaserScan: /front, /rear; to use one, remap: scan:=/front"
        );
    }
}
