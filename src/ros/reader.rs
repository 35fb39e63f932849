//! Decodes messages, and warns of those that cannot be used, at most once a second for each subject.

use std::fmt::Display;
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
    monitor: Arc<Monitor>,
    throttle: Throttle,
}

impl Reader {
    /// Messages that are rejected are counted by `monitor`.
    pub(super) fn new(clock: &Arc<dyn Clock>, log: &Log, monitor: &Arc<Monitor>) -> Self {
        Self { clock: Arc::clone(clock), log: log.clone(), monitor: Arc::clone(monitor), throttle: Throttle::default() }
    }

    /// Decodes a message. `subject`: its name in the warning if that fails.
    pub(super) fn read<T: Message>(&mut self, subject: &'static str, raw: &RawMessage) -> Option<T> {
        decode(&raw.bytes).map_err(|error| self.refuse(subject, &raw.sender, &error)).ok()
    }

    /// Counts a message that is rejected, and warns.
    pub(super) fn refuse(&mut self, subject: &'static str, sender: &str, problem: &dyn Display) {
        self.monitor.count_refused();
        self.warn(subject, &format!("a message from {sender} is refused: {problem}"));
    }

    /// Another warning about a subject.
    pub(super) fn warn(&mut self, subject: &'static str, text: &str) {
        if self.throttle.allows(subject, self.clock.now()) {
            self.log.warn(&format!("{subject}: {text}"));
        }
    }
}
