//! A topic that a node subscribes to: name, type and handler. Each node has one list of its inputs.

use std::fmt::Display;

use super::context::Context;
use super::sink::{RawMessage, Topic};
use crate::messages::Message;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Empty;

type Handler<A> = Box<dyn Fn(&mut A, &RawMessage, &mut Context) + Send>;

/// A topic that the node of the algorithm `A` subscribes to.
pub(super) struct Input<A> {
    pub(super) topic: Topic,
    pub(super) handling: Handling<A>,
}

/// How messages are handled.
pub(super) enum Handling<A> {
    /// A scan to be processed, unless a newer one replaces it.
    Scan,
    /// A point cloud, handled in the same way.
    Cloud,
    /// A request to publish the answer at once.
    Interrupt,
    /// Any other message. These are handled in the order of arrival.
    Event(Handler<A>),
}

/// Topic of the scans or of the point clouds that a node processes.
pub(super) fn scan_topic(are_clouds: bool) -> &'static str {
    if are_clouds { "cloud" } else { "scan" }
}

impl<A> Input<A> {
    /// The scans or the point clouds that the node processes.
    pub(super) fn scans(are_clouds: bool) -> Self {
        let name = scan_topic(are_clouds);
        let (topic, handling) = if are_clouds {
            (Topic::of::<PointCloud2>(name), Handling::Cloud)
        } else {
            (Topic::of::<LaserScan>(name), Handling::Scan)
        };
        Self { topic, handling }.required()
    }

    /// Requests to publish the answer at once.
    pub(super) fn interrupts() -> Self {
        Self { topic: Topic::of::<Empty>("icp_interrupt"), handling: Handling::Interrupt }
    }

    /// Messages of type `T`. Each is passed to `take` in the order of arrival, and rejected if `take` returns an error.
    pub(super) fn of<T: Message, E: Display>(
        name: &'static str,
        take: impl Fn(&mut A, &T) -> Result<(), E> + Send + 'static,
    ) -> Self {
        Self::with_context(name, move |algorithm, message, _, _| take(algorithm, message))
    }

    /// The same, but `take` also receives the raw message and the context of the worker thread.
    pub(super) fn with_context<T: Message, E: Display>(
        name: &'static str,
        take: impl Fn(&mut A, &T, &RawMessage, &mut Context) -> Result<(), E> + Send + 'static,
    ) -> Self {
        let handler = move |algorithm: &mut A, raw: &RawMessage, context: &mut Context| {
            if let Some(message) = context.reader.read::<T>(name, raw)
                && let Err(problem) = take(algorithm, &message, raw, context)
            {
                context.reader.reject(name, &raw.sender, &problem);
            }
        };
        Self { topic: Topic::of::<T>(name), handling: Handling::Event(Box::new(handler)) }
    }

    /// Marks an input without which the node cannot do its work.
    pub(super) fn required(mut self) -> Self {
        self.topic.is_required = true;
        self
    }
}
