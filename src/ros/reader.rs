//! Reading messages, and saying which cannot be used and why, of each subject at most once a second.

use std::error::Error;
use std::sync::Arc;

use super::diagnostics::Monitor;
use super::log::{Log, Throttle};
use super::sink::RawMessage;
use crate::anytime::clock::Clock;
use crate::messages::{Message, decode};

/// What a thread that works on messages reads them by.
pub(super) struct Reader {
    clock: Arc<dyn Clock>,
    log: Log,
    /// What counts the messages that are refused.
    monitor: Option<Arc<Monitor>>,
    throttle: Throttle,
}

impl Reader {
    pub(super) fn new(clock: &Arc<dyn Clock>, log: &Log) -> Self {
        Self { clock: Arc::clone(clock), log: log.clone(), monitor: None, throttle: Throttle::default() }
    }

    /// The same; what is refused is counted.
    pub(super) fn counting(self, monitor: &Arc<Monitor>) -> Self {
        Self { monitor: Some(Arc::clone(monitor)), ..self }
    }

    /// The message of a raw, if it is one. `subject`: what it is called where it is none.
    pub(super) fn read<T: Message>(&mut self, subject: &'static str, raw: &RawMessage) -> Option<T> {
        decode(&raw.bytes).map_err(|error| self.refuse(subject, &raw.sender, &error)).ok()
    }

    /// A message is of no use.
    pub(super) fn refuse(&mut self, subject: &'static str, sender: &str, problem: &dyn Error) {
        if let Some(monitor) = &self.monitor {
            monitor.count_refused();
        }
        self.warn(subject, &format!("a message from {sender} is refused: {problem}"));
    }

    /// Something else about a subject.
    pub(super) fn warn(&mut self, subject: &'static str, text: &str) {
        if self.throttle.allows(subject, self.clock.now()) {
            self.log.warn(&format!("{subject}: {text}"));
        }
    }
}
