//! Rate, gaps and stamps of a topic.

use std::cmp::Ordering;

use serde::Serialize;

use crate::messages::header_stamp;
use crate::time::Stamp;

use super::super::{BagMessage, Connection};

/// An interval is a gap if it is longer than this many times the mean interval. (Not the median, which is near zero in logs
/// written in bursts.)
const GAP_FACTOR: f64 = 3.0;

/// Summary of a topic, with the timing of its messages: by the stamps in their headers, or by the recording times if the messages
/// have no headers.
#[derive(Clone, Debug, Serialize)]
pub struct TopicSummary {
    /// Name of the topic.
    pub topic: String,
    /// Type of the messages.
    pub message_type: String,
    /// Number of messages read.
    pub messages: u64,
    /// Mean rate, Hz.
    pub rate_hz: Option<f64>,
    /// Longest interval between two messages, s.
    pub longest_interval_s: Option<f64>,
    /// Number of intervals longer than three times the mean interval.
    pub gaps: usize,
    /// Number of stamps earlier than the one before.
    pub stamps_back: u64,
    /// Number of stamps equal to the one before.
    pub stamps_repeated: u64,
}

impl TopicSummary {
    pub(super) fn problems(&self) -> Vec<String> {
        let Self { topic, messages, stamps_back, stamps_repeated, gaps, .. } = self;
        let mut problems = Vec::new();
        if *stamps_back > 0 {
            problems.push(format!("{topic}: {stamps_back} of {messages} stamps go back in time"));
        }
        if *stamps_repeated > 0 {
            problems.push(format!("{topic}: {stamps_repeated} of {messages} stamps are equal to the one before"));
        }
        if let (1.., Some(longest)) = (*gaps, self.longest_interval_s) {
            let plural = if *gaps == 1 { "" } else { "s" };
            problems.push(format!("{topic}: {gaps} gap{plural}, the longest {longest:.2} s"));
        }
        problems
    }
}

/// Statistics of a topic, collected while its messages are read.
pub(super) struct Statistics {
    topic: String,
    message_type: String,
    has_header: bool,
    messages: u64,
    previous: Option<Stamp>,
    /// Intervals between consecutive messages, s; only those above zero.
    intervals: Vec<f64>,
    stamps_back: u64,
    stamps_repeated: u64,
}

impl Statistics {
    pub(super) fn new(connection: &Connection) -> Self {
        Self {
            topic: connection.topic.clone(),
            message_type: connection.message_type.clone(),
            has_header: begins_with_header(&connection.definition),
            messages: 0,
            previous: None,
            intervals: Vec::new(),
            stamps_back: 0,
            stamps_repeated: 0,
        }
    }

    pub(super) fn add(&mut self, message: &BagMessage<'_>) {
        self.messages += 1;
        let stamp = if self.has_header { header_stamp(&message.data).unwrap_or(message.time) } else { message.time };
        if let Some(previous) = self.previous.replace(stamp) {
            match stamp.cmp(&previous) {
                Ordering::Less => self.stamps_back += 1,
                // Messages without stamps may be recorded at the same time.
                Ordering::Equal => self.stamps_repeated += u64::from(self.has_header),
                Ordering::Greater => self.intervals.push(stamp.seconds_since(previous)),
            }
        }
    }

    pub(super) fn summary(self) -> TopicSummary {
        let count = self.intervals.len() as f64;
        let mean = (count > 0.0).then(|| self.intervals.iter().sum::<f64>() / count);
        TopicSummary {
            topic: self.topic,
            message_type: self.message_type,
            messages: self.messages,
            rate_hz: mean.map(f64::recip),
            longest_interval_s: self.intervals.iter().copied().reduce(f64::max),
            gaps: self.intervals.iter().filter(|&&interval| mean.is_some_and(|mean| interval > GAP_FACTOR * mean)).count(),
            stamps_back: self.stamps_back,
            stamps_repeated: self.stamps_repeated,
        }
    }
}

/// Whether the first field of a message definition is a `Header`.
fn begins_with_header(definition: &str) -> bool {
    let fields = definition.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
    let first = fields.filter(|line| !line.is_empty() && !line.contains('=')).find_map(|line| line.split_whitespace().next());
    matches!(first, Some("Header" | "std_msgs/Header"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_recognized_in_the_definition() {
        assert!(begins_with_header("# Single scan\n#\n\nHeader header # stamp of the first ray\nfloat32 angle_min"));
        assert!(begins_with_header("uint8 KIND=1\nstd_msgs/Header header"));
        assert!(!begins_with_header("geometry_msgs/TransformStamped[] transforms\n===\nMSG: x\nHeader header"));
        assert!(!begins_with_header(""));
    }
}
