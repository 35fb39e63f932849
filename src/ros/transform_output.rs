//! Publishes transforms. Each can be switched on and off while the node runs, and is switched off if another node publishes it
//! too.

use std::collections::BTreeSet;
use std::sync::Mutex;

use rosrust::api::Ros;

use super::NodeError;
use super::context::Shared;
use super::diagnostics::TRANSFORM_WITHHELD;
use super::output::Output;
use crate::messages::geometry_msgs::TransformStamped;
use crate::messages::tf2_msgs::TFMessage;
use crate::parallel::lock;
use crate::transforms::frame_name;

/// Another node that publishes a transform which conflicts with one of this node.
pub(super) struct ConflictingPublisher<'a> {
    sender: &'a str,
    parent: &'a str,
    child: &'a str,
}

impl<'a> ConflictingPublisher<'a> {
    /// Finds a transform to `child` in a message.
    pub(super) fn find(message: &'a TFMessage, sender: &'a str, child: &'a str) -> Option<Self> {
        let child = frame_name(child);
        let transform = message.transforms.iter().find(|transform| frame_name(&transform.child_frame_id) == child)?;
        Some(Self { sender, parent: frame_name(&transform.header.frame_id), child })
    }

    /// A conflict with the transform from `parent` to `child`, which may be a chain of several.
    pub(super) fn new(sender: &'a str, parent: &'a str, child: &'a str) -> Self {
        Self { sender, parent: frame_name(parent), child: frame_name(child) }
    }
}

/// Publisher of `/tf`, advertised while at least one transform is on.
#[derive(Default)]
pub(super) struct TransformOutput(Mutex<State>);

#[derive(Default)]
struct State {
    output: Option<Output<TFMessage>>,
    /// Child frames of the transforms that are on.
    children: BTreeSet<String>,
}

impl TransformOutput {
    /// Switches the transform to `child` on or off. If none is on, the node no longer advertises `/tf`.
    pub(super) fn switch(&self, ros: &Ros, child: &str, on: bool) -> Result<(), NodeError> {
        let mut state = lock(&self.0);
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

    /// Stops publishing the transform to `child`, and warns if it was on. A frame can have only one parent, and the other
    /// publisher takes precedence: it was there first, or knows better, as a simulator does.
    pub(super) fn yield_to(&self, other: &ConflictingPublisher, child: &str, shared: &Shared) {
        let ConflictingPublisher { sender, parent, child: other_child } = other;
        if lock(&self.0).remove(child) {
            shared.log.warn(&format!(
                "{sender} publishes the transform {parent} -> {other_child}: this node stops publishing its own transform to \
                 {child}, since a frame can have only one parent (to choose, set the parameters publish_tf and publish_map_tf)",
            ));
            shared.monitor.set_condition(TRANSFORM_WITHHELD, true);
        }
    }

    /// Publishes those of the transforms that are on.
    pub(super) fn send<const N: usize>(&self, transforms: impl FnOnce() -> [TransformStamped; N]) {
        let State { output, children } = &*lock(&self.0);
        let is_on = |transform: &TransformStamped| children.contains(frame_name(&transform.child_frame_id));
        if let Some(output) = output {
            output.send(|| TFMessage { transforms: transforms().into_iter().filter(is_on).collect() });
        }
    }
}

impl State {
    /// Switches the transform to `child` off. Returns whether it was on.
    fn remove(&mut self, child: &str) -> bool {
        let was_on = self.children.remove(frame_name(child));
        if self.children.is_empty() {
            self.output = None;
        }
        was_on
    }
}
