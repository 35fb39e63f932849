//! Returns the messages of a bag with the odometry ahead of all others, which is possible only with a recording.
//!
//! Odometry that was stamped late arrives after the scans to which it belongs. A robot must process these scans without it; when
//! a bag is read, the later odometry is already known.

use std::collections::VecDeque;
use std::time::Duration;

use crate::io::bag::{BagError, BagMessage};
use crate::messages::header_stamp;
use crate::time::Stamp;

/// Iterator over the messages of a bag that returns those of one topic earlier than the others.
pub(super) struct EarlyTopic<'a, 'bag, I> {
    messages: I,
    topic: Option<&'a str>,
    /// How much earlier, s.
    advance: f64,
    /// Messages of other topics, held back until they are due.
    held: VecDeque<BagMessage<'bag>>,
    /// Number of held messages to return regardless of their time.
    to_flush: usize,
    /// Recording time and stamp of the last message of the topic.
    last: Option<(Stamp, Stamp)>,
}

impl<'a, 'bag, I: Iterator<Item = Result<BagMessage<'bag>, BagError>>> EarlyTopic<'a, 'bag, I> {
    pub(super) fn new(messages: I, topic: Option<&'a str>, advance: Duration) -> Self {
        Self { messages, topic, advance: advance.as_secs_f64(), held: VecDeque::new(), to_flush: 0, last: None }
    }

    /// Whether the stamp of a message has changed differently from the recording time: then the clock was set, and the messages
    /// must stay in their order.
    fn has_jumped(&mut self, message: &BagMessage) -> bool {
        let stamp = header_stamp(&message.data).unwrap_or(message.time);
        let last = self.last.replace((message.time, stamp));
        last.is_some_and(|(time, before)| (stamp.seconds_since(before) - message.time.seconds_since(time)).abs() > self.advance)
    }

    /// Returns the next held message if it is due, or in any case without `now`.
    fn take_held(&mut self, now: Option<Stamp>) -> Option<BagMessage<'bag>> {
        let is_due = |message: &BagMessage| now.is_none_or(|now| now.seconds_since(message.time) >= self.advance);
        if self.to_flush == 0 && !self.held.front().is_some_and(is_due) {
            return None;
        }
        self.to_flush = self.to_flush.saturating_sub(1);
        self.held.pop_front()
    }
}

impl<'bag, I: Iterator<Item = Result<BagMessage<'bag>, BagError>>> Iterator for EarlyTopic<'_, 'bag, I> {
    type Item = Result<BagMessage<'bag>, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut now = self.held.back().map(|message| message.time);
        loop {
            if let Some(message) = now.and_then(|now| self.take_held(Some(now))) {
                return Some(Ok(message));
            }
            let message = match self.messages.next() {
                Some(Ok(message)) => message,
                Some(Err(error)) => return Some(Err(error)),
                None => return self.take_held(None).map(Ok),
            };
            now = Some(message.time);
            if self.topic == Some(message.connection.topic.as_str()) {
                if !self.has_jumped(&message) {
                    return Some(Ok(message));
                }
                self.to_flush = self.held.len() + 1;
            }
            self.held.push_back(message);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::bag::{Bag, BagWriter, Compression};
    use crate::messages::nav_msgs::Odometry;
    use crate::messages::sensor_msgs::LaserScan;

    /// The order in which messages are returned if the odometry is advanced by `advance` ms: for each, whether it is odometry,
    /// and its recording time in tenths of a second. The bag has three seconds of odometry and scans at 10 Hz; in its second
    /// half, the stamps of the odometry are set back by `set_back` s.
    fn order(advance: u64, set_back: f64) -> Vec<(bool, i64)> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.bag");
        let mut writer = BagWriter::create_whole(&path, Compression::None).unwrap();
        let start = Stamp::from_seconds(100.0);
        for i in 0..30 {
            let time = start.offset_by(0.1 * f64::from(i));
            let mut odometry = Odometry::default();
            odometry.header.stamp = time.offset_by(if i < 15 { 0.0 } else { -set_back }).into();
            writer.write("/odom", time, &odometry).unwrap();
            let mut scan = LaserScan::default();
            scan.header.stamp = time.into();
            writer.write("/scan", time.offset_by(0.01), &scan).unwrap();
        }
        writer.finish().unwrap();
        let bag = Bag::open(&path).unwrap();
        let messages = EarlyTopic::new(bag.messages(None), Some("/odom"), Duration::from_millis(advance)).map(Result::unwrap);
        let of = |message: BagMessage| {
            (message.connection.topic == "/odom", (10.0 * message.time.seconds_since(start) + 0.01).floor() as i64)
        };
        messages.map(of).collect()
    }

    #[test]
    fn odometry_is_returned_early_and_nothing_is_lost() {
        let as_recorded: Vec<_> = (0..30).flat_map(|i| [(true, i), (false, i)]).collect();
        assert_eq!(order(0, 0.0), as_recorded);
        let ahead = order(500, 0.0);
        for (k, &(_, scan)) in ahead.iter().enumerate().filter(|(_, (is_odometry, _))| !is_odometry) {
            let newest = ahead[..k].iter().filter(|(is_odometry, _)| *is_odometry).map(|&(_, time)| time).max();
            assert!(newest.is_some_and(|newest| newest >= (scan + 5).min(29) && newest <= scan + 6), "{scan}: {newest:?}");
        }
        assert_eq!(ahead.len(), 60);
    }

    #[test]
    fn messages_stay_in_order_when_the_clock_is_set() {
        let ahead = order(500, 3.0);
        let jump = ahead.iter().position(|&message| message == (true, 15)).unwrap();
        let before: Vec<i64> = ahead[..jump].iter().filter(|(is_odometry, _)| !is_odometry).map(|&(_, time)| time).collect();
        assert_eq!(before, (0..15).collect::<Vec<_>>());
    }
}
