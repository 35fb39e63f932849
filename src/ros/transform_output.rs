//! The output of transforms, each of which can be switched while a node runs, and gives way to another node's.

use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

use rosrust::api::Ros;

use super::NodeError;
use super::output::Output;
use crate::messages::geometry_msgs::TransformStamped;
use crate::messages::tf2_msgs::TFMessage;
use crate::transforms::frame_name;

/// Another node's transform.
pub(super) struct ConflictingPublisher<'a> {
    sender: &'a str,
    parent: &'a str,
    child: &'a str,
}

impl<'a> ConflictingPublisher<'a> {
    /// The transform that says where `child` is, if the message has one.
    pub(super) fn find(message: &'a TFMessage, sender: &'a str, child: &'a str) -> Option<Self> {
        let child = frame_name(child);
        let transform = message.transforms.iter().find(|transform| frame_name(&transform.child_frame_id) == child)?;
        Some(Self { sender, parent: frame_name(&transform.header.frame_id), child })
    }

    /// One that leads from `parent` to `child`, in one step or several.
    pub(super) fn new(sender: &'a str, parent: &'a str, child: &'a str) -> Self {
        Self { sender, parent: frame_name(parent), child: frame_name(child) }
    }
}

/// `/tf`, while there is something to say there.
#[derive(Default)]
pub(super) struct TransformOutput(Mutex<State>);

#[derive(Default)]
struct State {
    output: Option<Output<TFMessage>>,
    /// The frames whose places are said.
    children: BTreeSet<String>,
}

impl TransformOutput {
    /// Whether to say where `child` is. As nothing is said any more, other nodes do not see this one among the publishers.
    pub(super) fn switch(&self, ros: &Ros, child: &str, on: bool) -> Result<(), NodeError> {
        let mut state = self.lock();
        if on {
            state.children.insert(frame_name(child).into());
            if state.output.is_none() {
                state.output = Some(Output::new(ros, "/tf")?);
            }
        } else {
            state.remove(child);
        }
        Ok(())
    }

    /// A frame has one parent. Who else publishes one was there first, or knows better, as a simulator does: then the place of `child`
    /// is said no more, if it was, and this is what to tell of it.
    pub(super) fn give_way(&self, rival: &ConflictingPublisher, child: &str) -> Option<String> {
        let ConflictingPublisher { sender, parent, child: rival } = rival;
        self.lock().remove(child).then(|| {
            format!(
                "{sender} publishes the transform {parent} -> {rival}: this node's own to {child} is held back from now on, as a frame \
                 has one parent (parameters publish_tf, publish_map_tf)",
            )
        })
    }

    /// Hands over those transforms that are on.
    pub(super) fn send<const N: usize>(&self, transforms: impl FnOnce() -> [TransformStamped; N]) {
        let State { output, children } = &*self.lock();
        let is_on = |transform: &TransformStamped| children.contains(frame_name(&transform.child_frame_id));
        if let Some(output) = output {
            output.send(|| TFMessage { transforms: transforms().into_iter().filter(is_on).collect() });
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Whether it was there.
    fn remove(&mut self, child: &str) -> bool {
        let was_there = self.children.remove(frame_name(child));
        if self.children.is_empty() {
            self.output = None;
        }
        was_there
    }
}
