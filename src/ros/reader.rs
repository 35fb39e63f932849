//! Decodes messages, and warns of rejected ones at most once per second and subject.

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
    /// `monitor` counts the rejected messages.
    pub(super) fn new(clock: &Arc<dyn Clock>, log: &Log, monitor: &Arc<Monitor>) -> Self {
        Self { clock: Arc::clone(clock), log: log.clone(), monitor: Arc::clone(monitor), throttle: Throttle::default() }
    }

    /// Decodes a message. If that fails, the message is rejected; `subject` names it in the warning.
    pub(super) fn read<T: Message>(&mut self, subject: &'static str, raw: &RawMessage) -> Option<T> {
        decode(&raw.bytes).map_err(|error| self.reject(subject, &raw.sender, &error)).ok()
    }

    /// Counts a rejected message and warns.
    pub(super) fn reject(&mut self, subject: &'static str, sender: &str, problem: &dyn Display) {
        self.monitor.count_rejected();
        self.warn(subject, &format!("message from {sender} rejected: {problem}"));
    }

    /// Warns about a subject.
    pub(super) fn warn(&mut self, subject: &'static str, text: &str) {
        if self.throttle.allows(subject, self.clock.now()) {
            self.log.warn(&format!("{subject}: {text}"));
        }
    }
}
