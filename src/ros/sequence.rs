//! Detection of scans lost in transport: in a burst, a publisher may drop messages without a notice.

use std::collections::HashMap;

use super::sink::RawMessage;

/// Maximum gap in the sequence numbers that counts as lost scans. A larger one is a new sequence.
const MAX_GAP: u32 = 100;

/// Tracks the `header.seq` of each sender's scans.
#[derive(Default)]
pub(super) struct SequenceTracker {
    last: HashMap<String, u32>,
}

impl SequenceTracker {
    /// Number of scans missing before this message. The first field of every message with a header is its sequence number.
    pub(super) fn lost_before(&mut self, message: &RawMessage) -> u32 {
        let Some(number) = message.bytes.first_chunk().map(|bytes| u32::from_le_bytes(*bytes)) else { return 0 };
        let Some(last) = self.last.insert(message.sender.clone(), number) else { return 0 };
        let lost = number.wrapping_sub(last).saturating_sub(1);
        if lost <= MAX_GAP { lost } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn gaps_in_the_sequence_numbers_of_a_sender_are_losses() {
        let mut sequence = SequenceTracker::default();
        let mut lost = |sender: &str, number: u32| {
            let bytes = number.to_le_bytes().to_vec();
            sequence.lost_before(&RawMessage { arrival: Duration::ZERO, sender: sender.into(), bytes })
        };
        assert_eq!([lost("/a", 7), lost("/a", 8), lost("/a", 11)], [0, 0, 2]);
        assert_eq!([lost("/b", 0), lost("/b", 0), lost("/b", 0)], [0, 0, 0], "a sender without sequence numbers");
        assert_eq!([lost("/a", 3), lost("/a", 4)], [0, 0], "a restarted bag");
        assert_eq!(lost("/a", 1_000_000), 0, "a new sequence");
    }
}
