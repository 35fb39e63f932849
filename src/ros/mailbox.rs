//! Messages that have been received and not yet been processed.

use std::collections::VecDeque;
use std::mem;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::interrupts::LOOK;
use super::live_params::MatchingChange;
use super::sink::RawMessage;
use crate::anytime::interrupt::Interrupt;

/// Capacity in events: four seconds of odometry at 1 kHz. During a longer match the oldest are lost.
const CAPACITY: usize = 4096;
/// Capacity in bytes: ordinary messages are small.
const CAPACITY_BYTES: usize = 32 << 20;
/// Scans that may wait, however patient they are: a third of a second at 1 kHz.
const SCANS: usize = 333;

/// Anything but a scan.
#[derive(Debug, PartialEq)]
pub(super) enum Event {
    /// A message of the input of this index among those of the node.
    Message(usize, RawMessage),
    /// A request that is no message.
    Request(Request),
}

/// What is asked of a node by its services and parameters.
#[derive(Debug, PartialEq)]
pub(super) enum Request {
    /// A call of the service that starts again, whatever that is to the node.
    Reset,
    /// A call of the service `save_profile`.
    SaveProfile,
    /// A parameter was changed.
    Change(MatchingChange),
}

impl Event {
    fn bytes(&self) -> usize {
        match self {
            Self::Message(_, raw) => raw.bytes.len(),
            Self::Request(_) => 0,
        }
    }
}

/// Work to do: first the events, in their order of arrival, then the scan.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Work {
    pub(super) events: VecDeque<Event>,
    pub(super) scan: Option<RawMessage>,
}

/// Work for the thread of a node. A scan gives way to one that comes so long after it as scans may wait in line: at first at once, as an
/// answer to an old one helps nobody.
#[derive(Default)]
pub(super) struct Mailbox {
    state: Mutex<State>,
    filled: Condvar,
}

#[derive(Default)]
struct State {
    events: VecDeque<Event>,
    /// Of the events' messages.
    bytes: usize,
    /// In the order of arrival.
    scans: VecDeque<RawMessage>,
    /// How long a scan may wait in line.
    patience: Duration,
    dropped: Dropped,
    closed: bool,
}

impl State {
    fn take(&mut self) -> Work {
        Work { events: self.take_events(), scan: self.scans.pop_front() }
    }

    fn take_events(&mut self) -> VecDeque<Event> {
        self.bytes = 0;
        mem::take(&mut self.events)
    }

    /// The scans that have to give way to the newest one go.
    fn drop_old_scans(&mut self) {
        let Some(newest) = self.scans.back().map(|raw| raw.arrival) else { return };
        let gives_way = |raw: &RawMessage| newest.saturating_sub(raw.arrival) >= self.patience;
        let last = self.scans.len() - 1;
        let old = self.scans.iter().take(last).take_while(|raw| gives_way(raw)).count();
        let old = old.max((last + 1).saturating_sub(SCANS));
        self.scans.drain(..old);
        self.dropped.scans += old as u64;
    }

    fn is_overfull(&self) -> bool {
        self.events.len() > CAPACITY || self.bytes > CAPACITY_BYTES
    }

    fn is_idle(&mut self) -> bool {
        !self.closed && self.scans.is_empty() && self.events.is_empty()
    }

    /// Whether there is nothing to go on with while a scan is held back, nor a newer one that it gives way to.
    fn is_idle_for_held_scan(&mut self) -> bool {
        self.events.is_empty() && !self.is_held_scan_over()
    }

    /// Whether a scan that is held back gives way to a newer one, or to the end.
    fn is_held_scan_over(&self) -> bool {
        self.closed || (self.patience.is_zero() && !self.scans.is_empty())
    }
}

/// Interrupts deferred work when another scan is here.
pub(super) struct NextScan<'a>(pub(super) &'a Mailbox);

impl Interrupt for NextScan<'_> {
    fn is_requested(&self) -> bool {
        self.0.has_scan()
    }
}

/// Messages that were lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Dropped {
    /// Scans replaced by newer ones, or lost on their way.
    pub(super) scans: u64,
    /// Other messages.
    pub(super) events: u64,
}

impl Mailbox {
    pub(super) fn put_scan(&self, raw: RawMessage) {
        let mut state = self.lock();
        state.scans.push_back(raw);
        state.drop_old_scans();
        self.filled.notify_one();
    }

    pub(super) fn put_event(&self, event: Event) {
        let mut state = self.lock();
        state.bytes += event.bytes();
        state.events.push_back(event);
        while state.is_overfull()
            && let Some(oldest) = state.events.pop_front()
        {
            state.bytes -= oldest.bytes();
            state.dropped.events += 1;
        }
        self.filled.notify_one();
    }

    /// From now on scans wait in line for so long; for none: the newest takes the place of the one before.
    pub(super) fn set_patience(&self, patience: Duration) {
        let mut state = self.lock();
        if state.patience != patience {
            state.patience = patience;
            state.drop_old_scans();
        }
    }

    /// Counts scans that were lost on their way.
    pub(super) fn count_lost_scans(&self, count: u64) {
        self.lock().dropped.scans += count;
    }

    /// Waits for work. `None` once the mailbox is closed.
    pub(super) fn take(&self) -> Option<Work> {
        let mut state = self.filled.wait_while(self.lock(), State::is_idle).unwrap_or_else(PoisonError::into_inner);
        (!state.closed).then(|| state.take())
    }

    /// Waits for work, but no longer than `timeout`: then there may be none. `None` once the mailbox is closed.
    pub(super) fn take_within(&self, timeout: Duration) -> Option<Work> {
        let waited = self.filled.wait_timeout_while(self.lock(), timeout, State::is_idle);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (!state.closed).then(|| state.take())
    }

    /// The events to go on with while a scan is held back, for which there is so much time `left`. `None`: it is to be answered now.
    pub(super) fn events_for_held_scan(&self, left: Duration, interrupt: &dyn Interrupt) -> Option<VecDeque<Event>> {
        let wait_no_more = left.is_zero() || interrupt.is_requested() || self.lock().is_held_scan_over();
        (!wait_no_more).then(|| self.take_events(left.min(LOOK)).unwrap_or_default())
    }

    /// Waits for events while a scan is held back: at most `timeout`, and no longer once it gives way to a newer one. `None`: none came.
    fn take_events(&self, timeout: Duration) -> Option<VecDeque<Event>> {
        let waited = self.filled.wait_timeout_while(self.lock(), timeout, State::is_idle_for_held_scan);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let events = state.take_events();
        (!events.is_empty()).then_some(events)
    }

    /// Whether a scan is waiting.
    pub(super) fn has_scan(&self) -> bool {
        !self.lock().scans.is_empty()
    }

    pub(super) fn dropped(&self) -> Dropped {
        self.lock().dropped
    }

    /// Ends [`Self::take`].
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_all();
    }

    /// The state is consistent at every moment, even if a thread has panicked while it held the lock.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESET: Event = Event::Request(Request::Reset);

    fn raw(arrival: u64) -> RawMessage {
        RawMessage { arrival: Duration::from_millis(arrival), sender: "/driver".into(), bytes: Vec::new() }
    }

    #[test]
    fn the_newest_scan_wins_and_events_keep_their_order() {
        let mailbox = Mailbox::default();
        mailbox.put_event(Event::Message(0, raw(1)));
        mailbox.put_scan(raw(2));
        mailbox.put_event(RESET);
        mailbox.put_scan(raw(3));
        let work = mailbox.take().unwrap();
        assert_eq!(work.scan, Some(raw(3)));
        assert_eq!(work.events, [Event::Message(0, raw(1)), RESET]);
        assert_eq!(mailbox.dropped(), Dropped { scans: 1, events: 0 });
    }

    #[test]
    fn patient_scans_wait_in_line_and_the_old_ones_go() {
        let mailbox = Mailbox::default();
        mailbox.set_patience(Duration::from_millis(10));
        (0..4).for_each(|i| mailbox.put_scan(raw(4 * i)));
        let next = || mailbox.take_within(Duration::ZERO).unwrap().scan.map(|scan| scan.arrival.as_millis());
        assert_eq!((next(), mailbox.dropped().scans), (Some(4), 1), "the first gave way to the last");
        assert_eq!(mailbox.take_events(Duration::from_millis(1)), None);
        mailbox.put_event(RESET);
        assert_eq!(mailbox.take_events(Duration::from_secs(60)), Some(VecDeque::from([RESET])), "whatever scans wait");
        assert_eq!((next(), next(), next(), mailbox.dropped().scans), (Some(8), Some(12), None, 1));
        (0..SCANS as u64 + 5).for_each(|_| mailbox.put_scan(raw(100)));
        assert_eq!(mailbox.dropped().scans, 6, "of so many at once some go");
        mailbox.set_patience(Duration::ZERO);
        assert_eq!((next(), next(), mailbox.dropped().scans), (Some(100), None, 5 + SCANS as u64));
    }

    #[test]
    fn a_full_mailbox_loses_the_oldest_events_and_counts_them() {
        let mailbox = Mailbox::default();
        for arrival in 0..CAPACITY as u64 + 2 {
            mailbox.put_event(Event::Message(0, raw(arrival)));
        }
        let work = mailbox.take().unwrap();
        assert_eq!((work.events.len(), work.events.front()), (CAPACITY, Some(&Event::Message(0, raw(2)))));
        assert_eq!(mailbox.dropped(), Dropped { scans: 0, events: 2 });
    }

    #[test]
    fn events_that_wait_take_no_more_memory_than_they_may() {
        let mailbox = Mailbox::default();
        for arrival in 0..5 {
            let bytes = vec![0; CAPACITY_BYTES / 3];
            mailbox.put_event(Event::Message(0, RawMessage { bytes, ..raw(arrival) }));
        }
        assert_eq!((mailbox.take().unwrap().events.len(), mailbox.dropped().events), (3, 2));
        mailbox.put_event(Event::Message(0, RawMessage { bytes: vec![0; CAPACITY_BYTES + 1], ..raw(6) }));
        mailbox.put_event(RESET);
        assert_eq!((mailbox.take().unwrap().events.len(), mailbox.dropped().events), (1, 3), "too long to be kept at all");
    }

    #[test]
    fn a_held_scan_waits_for_events_but_not_for_ever() {
        let mailbox = Mailbox::default();
        assert_eq!(mailbox.take_events(Duration::from_millis(1)), None);
        mailbox.put_event(RESET);
        assert_eq!(mailbox.take_events(Duration::from_secs(60)), Some(VecDeque::from([RESET])));
        mailbox.put_scan(raw(1));
        assert_eq!(mailbox.take_events(Duration::from_secs(60)), None, "a newer scan ends the wait");
    }

    #[test]
    fn a_timer_is_not_held_up_where_there_is_nothing() {
        let mailbox = Mailbox::default();
        assert_eq!(mailbox.take_within(Duration::from_millis(1)), Some(Work::default()));
        mailbox.put_scan(raw(1));
        assert_eq!(mailbox.take_within(Duration::from_secs(60)).unwrap().scan, Some(raw(1)));
        mailbox.close();
        assert_eq!(mailbox.take_within(Duration::from_secs(60)), None);
    }

    #[test]
    fn closing_ends_the_wait() {
        let mailbox = Mailbox::default();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| mailbox.take());
            mailbox.close();
            assert_eq!(waiting.join().unwrap(), None);
        });
    }
}
