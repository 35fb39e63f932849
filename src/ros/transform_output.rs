//! The output of transforms, which can be switched while a node runs, and gives way to another node's.

use std::sync::{Mutex, MutexGuard, PoisonError};

use rosrust::api::Ros;
use rosrust_msg::tf2_msgs::TFMessage;

use super::NodeError;
use super::master::Role;
use super::publishers::Output;
use crate::messages::tf2_msgs as messages;
use crate::transforms::frame_name;

/// `/tf`, while it is on.
#[derive(Default)]
pub(super) struct TransformOutput(Mutex<Option<Output<TFMessage>>>);

impl TransformOutput {
    /// On or off; as it is off, other nodes do not see this one among the publishers.
    pub(super) fn switch(&self, ros: &Ros, on: bool) -> Result<(), NodeError> {
        let mut output = self.lock();
        if on != output.is_some() {
            *output = if on { Some(Output::new(ros, "/tf")?) } else { None };
        }
        Ok(())
    }

    /// A frame has one parent. Who else publishes one for `child` was there first, or knows better, as a simulator does: then the
    /// publication ends, if there was any, and this is what to say of it.
    pub(super) fn give_way(&self, message: &messages::TFMessage, sender: &str, child: &str) -> Option<String> {
        let child = frame_name(child);
        let rival = message.transforms.iter().find(|transform| frame_name(&transform.child_frame_id) == child)?;
        self.lock().take()?;
        Some(format!(
            "{sender} publishes the transform {} -> {child}: this node's own is held back from now on, as a frame has one parent \
             (parameter publish_tf)",
            rival.header.frame_id,
        ))
    }

    /// Hands a message over, if it is on.
    pub(super) fn send(&self, message: impl FnOnce() -> TFMessage) {
        if let Some(output) = self.lock().as_ref() {
            output.send(message);
        }
    }

    /// How it stands in the master's books.
    pub(super) fn role(&self) -> Option<Role> {
        self.lock().as_ref().map(Output::role)
    }

    fn lock(&self) -> MutexGuard<'_, Option<Output<TFMessage>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
