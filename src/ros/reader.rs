//! Decodes messages, and warns of those that cannot be used, at most once a second for each subject.

use std::error::Error;
use std::sync::Arc;

use super::diagnostics::Monitor;
use super::log::{Log, Throttle};
use super::sink::RawMessage;
use crate::anytime::clock::Clock;
use crate::messages::{Message, decode};

/// Decodes messages for one thread.
pub(super) struct Reader {
    clock: Arc<dyn Clock>,
    log: Log,
    /// Counts the messages that are rejected.
    monitor: Option<Arc<Monitor>>,
    throttle: Throttle,
}

impl Reader {
    pub(super) fn new(clock: &Arc<dyn Clock>, log: &Log) -> Self {
        Self { clock: Arc::clone(clock), log: log.clone(), monitor: None, throttle: Throttle::default() }
    }

    /// The same; rejected messages are counted.
    pub(super) fn counting(self, monitor: &Arc<Monitor>) -> Self {
        Self { monitor: Some(Arc::clone(monitor)), ..self }
    }

    /// Decodes a message. `subject`: its name in the warning if that fails.
    pub(super) fn read<T: Message>(&mut self, subject: &'static str, raw: &RawMessage) -> Option<T> {
        decode(&raw.bytes).map_err(|error| self.refuse(subject, &raw.sender, &error)).ok()
    }

    /// Counts a message that is rejected, and warns.
    pub(super) fn refuse(&mut self, subject: &'static str, sender: &str, problem: &dyn Error) {
        if let Some(monitor) = &self.monitor {
            monitor.count_refused();
        }
        self.warn(subject, &format!("a message from {sender} is refused: {problem}"));
    }

    /// Another warning about a subject.
    pub(super) fn warn(&mut self, subject: &'static str, text: &str) {
        if self.throttle.allows(subject, self.clock.now()) {
            self.log.warn(&format!("{subject}: {text}"));
        }
    }
}
