//! A topic that a node reads: its name, its type, and what is done with a message. A node lists each of its own once.

use std::fmt::Display;

use super::context::Context;
use super::sink::{RawMessage, Topic};
use crate::messages::Message;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Empty;

type Handler<A> = Box<dyn Fn(&mut A, &RawMessage, &mut Context) + Send>;

/// A topic that a node of the algorithm `A` reads.
pub(super) struct Input<A> {
    pub(super) topic: Topic,
    pub(super) handling: Handling<A>,
}

/// How messages are handled.
pub(super) enum Handling<A> {
    /// A scan is answered, unless a newer one replaces it.
    Scan,
    /// The same for a point cloud.
    Cloud,
    /// It asks for the answer now.
    Interrupt,
    /// It is taken into account, in the order of arrival.
    Event(Handler<A>),
}

impl<A> Input<A> {
    /// The scans that the node answers, or the point clouds.
    pub(super) fn scans(are_clouds: bool) -> Self {
        if are_clouds {
            Self { topic: Topic::vital::<PointCloud2>("cloud"), handling: Handling::Cloud }
        } else {
            Self { topic: Topic::vital::<LaserScan>("scan"), handling: Handling::Scan }
        }
    }

    /// Requests for the answer now.
    pub(super) fn interrupts() -> Self {
        Self { topic: Topic::of::<Empty>("icp_interrupt"), handling: Handling::Interrupt }
    }

    /// Messages of type `T`, each handed to `take` in the order of arrival. One that gives an error is refused.
    pub(super) fn of<T: Message, E: Display>(
        name: &'static str,
        take: impl Fn(&mut A, &T) -> Result<(), E> + Send + 'static,
    ) -> Self {
        Self::with_context(name, move |algorithm, message, _, _| take(algorithm, message))
    }

    /// The same; `take` is also given the message as it came, and the context of the thread.
    pub(super) fn with_context<T: Message, E: Display>(
        name: &'static str,
        take: impl Fn(&mut A, &T, &RawMessage, &mut Context) -> Result<(), E> + Send + 'static,
    ) -> Self {
        let handler = move |algorithm: &mut A, raw: &RawMessage, context: &mut Context| {
            if let Some(message) = context.reader.read::<T>(name, raw)
                && let Err(problem) = take(algorithm, &message, raw, context)
            {
                context.reader.refuse(name, &raw.sender, &problem);
            }
        };
        Self { topic: Topic::of::<T>(name), handling: Handling::Event(Box::new(handler)) }
    }

    /// The same input; without it the node does nothing useful.
    pub(super) fn vital(mut self) -> Self {
        self.topic.is_vital = true;
        self
    }
}
