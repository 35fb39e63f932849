//! A bag's messages with the odometry ahead of the rest: what only a recording can give.
//!
//! Odometry that was stamped late comes after the scans that it belongs to. A robot has to answer without it; who reads a bag knows what came
//! later.

use std::collections::VecDeque;
use std::time::Duration;

use crate::io::bag::{BagError, BagMessage};
use crate::messages::header_stamp;
use crate::time::Stamp;

/// Messages of a bag, those of one topic earlier than the others.
pub(super) struct Ahead<'a, 'bag, I> {
    messages: I,
    topic: Option<&'a str>,
    /// So much earlier, s.
    by: f64,
    /// Messages of other topics, until their time has come.
    held: VecDeque<BagMessage<'bag>>,
    /// So many of them are handed on whatever the time.
    flushed: usize,
    /// When the last one of the topic was recorded, and its stamp.
    last: Option<(Stamp, Stamp)>,
}

impl<'a, 'bag, I: Iterator<Item = Result<BagMessage<'bag>, BagError>>> Ahead<'a, 'bag, I> {
    pub(super) fn new(messages: I, topic: Option<&'a str>, by: Duration) -> Self {
        Self { messages, topic, by: by.as_secs_f64(), held: VecDeque::new(), flushed: 0, last: None }
    }

    /// Whether a message's stamp has not gone on as the time has: the clock was set, and everything stays in its order.
    fn has_jumped(&mut self, message: &BagMessage) -> bool {
        let stamp = header_stamp(&message.data).unwrap_or(message.time);
        let last = self.last.replace((message.time, stamp));
        last.is_some_and(|(time, before)| (stamp.seconds_since(before) - message.time.seconds_since(time)).abs() > self.by)
    }

    fn take_held(&mut self, now: Option<Stamp>) -> Option<BagMessage<'bag>> {
        let is_due = |message: &BagMessage| now.is_none_or(|now| now.seconds_since(message.time) >= self.by);
        if self.flushed == 0 && !self.held.front().is_some_and(is_due) {
            return None;
        }
        self.flushed = self.flushed.saturating_sub(1);
        self.held.pop_front()
    }
}

impl<'bag, I: Iterator<Item = Result<BagMessage<'bag>, BagError>>> Iterator for Ahead<'_, 'bag, I> {
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
                self.flushed = self.held.len() + 1;
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

    /// What comes of three seconds of odometry and scans, 10 times a second each, whose odometry is stamped so much earlier from the
    /// middle on, s: whether it is odometry, and the tenth of a second when it was recorded.
    fn order(by: u64, set_back: f64) -> Vec<(bool, i64)> {
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
        let messages = Ahead::new(bag.messages(None), Some("/odom"), Duration::from_millis(by)).map(Result::unwrap);
        let of = |message: BagMessage| {
            (message.connection.topic == "/odom", (10.0 * message.time.seconds_since(start) + 0.01).floor() as i64)
        };
        messages.map(of).collect()
    }

    #[test]
    fn odometry_comes_before_its_time_and_nothing_is_lost() {
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
    fn where_the_clock_is_set_everything_stays_in_its_order() {
        let ahead = order(500, 3.0);
        let jump = ahead.iter().position(|&message| message == (true, 15)).unwrap();
        let before: Vec<i64> = ahead[..jump].iter().filter(|(is_odometry, _)| !is_odometry).map(|&(_, time)| time).collect();
        assert_eq!(before, (0..15).collect::<Vec<_>>());
    }
}
