//! The output of transforms, which can be switched while the node runs.

use std::sync::{Mutex, MutexGuard, PoisonError};

use rosrust::api::Ros;
use rosrust_msg::tf2_msgs::TFMessage;

use super::NodeError;
use super::master::Role;
use super::publishers::Output;

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

    /// Ends the publication; whether there was any.
    pub(super) fn withhold(&self) -> bool {
        self.lock().take().is_some()
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
