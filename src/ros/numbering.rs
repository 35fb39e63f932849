//! Scans lost on their way: in a burst a publisher loses messages and does not say so.

use std::collections::HashMap;

use super::sink::RawMessage;

/// Gaps in the numbering of scans that are longer than this are no losses but another numbering.
const MAX_GAP: u32 = 100;

/// Watches the `header.seq` of each sender's scans.
#[derive(Default)]
pub(super) struct Numbering {
    last: HashMap<String, u32>,
}

impl Numbering {
    /// How many numbers were left out before this message. Every message with a header begins with its number.
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
    fn gaps_in_the_numbering_of_a_sender_are_losses() {
        let mut numbering = Numbering::default();
        let mut lost = |sender: &str, number: u32| {
            let bytes = number.to_le_bytes().to_vec();
            numbering.lost_before(&RawMessage { arrival: Duration::ZERO, sender: sender.into(), bytes })
        };
        assert_eq!([lost("/a", 7), lost("/a", 8), lost("/a", 11)], [0, 0, 2]);
        assert_eq!([lost("/b", 0), lost("/b", 0), lost("/b", 0)], [0, 0, 0], "a sender that does not count");
        assert_eq!([lost("/a", 3), lost("/a", 4)], [0, 0], "a bag that starts again");
        assert_eq!(lost("/a", 1_000_000), 0, "another numbering");
    }
}
