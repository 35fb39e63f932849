//! Queue of messages that have been received but not processed yet.

use std::collections::VecDeque;
use std::mem;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::interrupts::POLL_PERIOD;
use super::live_params::MatchingChange;
use super::sink::RawMessage;
use crate::anytime::interrupt::Interrupt;
use crate::parallel::lock;

/// Maximum number of queued events: four seconds of odometry at 1 kHz. During a longer match the oldest are lost.
const MAX_EVENTS: usize = 4096;
/// Maximum size of the queued events in bytes. Ordinary messages are small.
const MAX_EVENT_BYTES: usize = 32 << 20;
/// Maximum number of queued scans, whatever the maximum wait: a third of a second at 1 kHz.
const MAX_SCANS: usize = 333;

/// Anything that is queued except a scan.
#[derive(Debug, PartialEq)]
pub(super) enum Event {
    /// A message of the node's input with this index.
    Message(usize, RawMessage),
    /// A request by a service or a parameter.
    Request(Request),
}

/// A request to a node by one of its services or parameters.
#[derive(Debug, PartialEq)]
pub(super) enum Request {
    /// A call of the service that resets the node; what that means depends on the node.
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

/// A batch of work: first the events in the order of their arrival, then the scan.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Batch {
    pub(super) events: VecDeque<Event>,
    pub(super) scan: Option<RawMessage>,
}

/// The queue of a node's worker thread. A queued scan is dropped when a newer one arrives at least the maximum wait after
/// it. By default the maximum wait is zero: only the latest scan is processed.
#[derive(Default)]
pub(super) struct Mailbox {
    state: Mutex<State>,
    filled: Condvar,
}

#[derive(Default)]
struct State {
    events: VecDeque<Event>,
    /// Size of the queued events.
    bytes: usize,
    /// Queued scans in the order of arrival.
    scans: VecDeque<RawMessage>,
    /// Maximum wait of a scan in the queue.
    max_wait: Duration,
    dropped: Dropped,
    closed: bool,
}

impl State {
    fn take(&mut self) -> Batch {
        Batch { events: self.take_events(), scan: self.scans.pop_front() }
    }

    fn take_events(&mut self) -> VecDeque<Event> {
        self.bytes = 0;
        mem::take(&mut self.events)
    }

    /// Drops the scans that the newest one replaces.
    fn drop_old_scans(&mut self) {
        let Some(newest) = self.scans.back().map(|raw| raw.arrival) else { return };
        let is_replaced = |raw: &RawMessage| newest.saturating_sub(raw.arrival) >= self.max_wait;
        let last = self.scans.len() - 1;
        let old = self.scans.iter().take(last).take_while(|raw| is_replaced(raw)).count();
        let old = old.max((last + 1).saturating_sub(MAX_SCANS));
        self.scans.drain(..old);
        self.dropped.scans += old as u64;
    }

    fn is_overfull(&self) -> bool {
        self.events.len() > MAX_EVENTS || self.bytes > MAX_EVENT_BYTES
    }

    fn is_idle(&mut self) -> bool {
        !self.closed && self.scans.is_empty() && self.events.is_empty()
    }

    /// While a scan is held back for odometry: whether there are no events, and no reason to release the scan.
    fn is_idle_for_held_scan(&mut self) -> bool {
        self.events.is_empty() && !self.must_release_held_scan()
    }

    /// Whether to stop holding a scan back, because a newer one has arrived or the node ends.
    fn must_release_held_scan(&self) -> bool {
        self.closed || (self.max_wait.is_zero() && !self.scans.is_empty())
    }
}

/// Interrupts deferred work when another scan has arrived.
pub(super) struct NextScan<'a>(pub(super) &'a Mailbox);

impl Interrupt for NextScan<'_> {
    fn is_requested(&self) -> bool {
        self.0.has_scan()
    }
}

/// Numbers of lost messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Dropped {
    /// Scans replaced by newer ones, or lost in transport.
    pub(super) scans: u64,
    /// Other messages.
    pub(super) events: u64,
}

impl Mailbox {
    pub(super) fn put_scan(&self, raw: RawMessage) {
        let mut state = lock(&self.state);
        state.scans.push_back(raw);
        state.drop_old_scans();
        self.filled.notify_one();
    }

    pub(super) fn put_event(&self, event: Event) {
        let mut state = lock(&self.state);
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

    /// Sets the maximum wait of scans in the queue. Zero: every scan replaces the one before.
    pub(super) fn set_max_wait(&self, max_wait: Duration) {
        let mut state = lock(&self.state);
        if state.max_wait != max_wait {
            state.max_wait = max_wait;
            state.drop_old_scans();
        }
    }

    /// Counts scans that were dropped elsewhere: lost in transport, or replaced while they waited for the timer.
    pub(super) fn count_dropped_scans(&self, count: u64) {
        lock(&self.state).dropped.scans += count;
    }

    /// Waits for work. Returns `None` once the mailbox is closed.
    pub(super) fn take(&self) -> Option<Batch> {
        let mut state = self.filled.wait_while(lock(&self.state), State::is_idle).unwrap_or_else(PoisonError::into_inner);
        (!state.closed).then(|| state.take())
    }

    /// Waits for work for at most `timeout`; after that the batch may be empty. Returns `None` once the mailbox is closed.
    pub(super) fn take_within(&self, timeout: Duration) -> Option<Batch> {
        let waited = self.filled.wait_timeout_while(lock(&self.state), timeout, State::is_idle);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (!state.closed).then(|| state.take())
    }

    /// Waits for events while a scan is held back for at most `left`. Returns `None` if the scan must be processed now.
    pub(super) fn events_for_held_scan(&self, left: Duration, interrupt: &dyn Interrupt) -> Option<VecDeque<Event>> {
        let must_release = left.is_zero() || interrupt.is_requested() || lock(&self.state).must_release_held_scan();
        (!must_release).then(|| self.take_events(left.min(POLL_PERIOD)).unwrap_or_default())
    }

    /// Waits for events while a scan is held back, for at most `timeout` or until the scan must be released. Returns `None` if
    /// none came.
    fn take_events(&self, timeout: Duration) -> Option<VecDeque<Event>> {
        let waited = self.filled.wait_timeout_while(lock(&self.state), timeout, State::is_idle_for_held_scan);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let events = state.take_events();
        (!events.is_empty()).then_some(events)
    }

    /// Whether a scan is queued.
    pub(super) fn has_scan(&self) -> bool {
        !lock(&self.state).scans.is_empty()
    }

    pub(super) fn dropped(&self) -> Dropped {
        lock(&self.state).dropped
    }

    /// Ends [`Self::take`].
    pub(super) fn close(&self) {
        lock(&self.state).closed = true;
        self.filled.notify_all();
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
    fn only_the_latest_scan_is_kept_and_events_keep_their_order() {
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
    fn scans_wait_in_the_queue_for_at_most_the_maximum_wait() {
        let mailbox = Mailbox::default();
        mailbox.set_max_wait(Duration::from_millis(10));
        (0..4).for_each(|i| mailbox.put_scan(raw(4 * i)));
        let next = || mailbox.take_within(Duration::ZERO).unwrap().scan.map(|scan| scan.arrival.as_millis());
        assert_eq!((next(), mailbox.dropped().scans), (Some(4), 1), "the last one replaced the first");
        assert_eq!(mailbox.take_events(Duration::from_millis(1)), None);
        mailbox.put_event(RESET);
        assert_eq!(mailbox.take_events(Duration::from_secs(60)), Some(VecDeque::from([RESET])), "even while scans are queued");
        assert_eq!((next(), next(), next(), mailbox.dropped().scans), (Some(8), Some(12), None, 1));
        (0..MAX_SCANS as u64 + 5).for_each(|_| mailbox.put_scan(raw(100)));
        assert_eq!(mailbox.dropped().scans, 6, "the queue is bounded");
        mailbox.set_max_wait(Duration::ZERO);
        assert_eq!((next(), next(), mailbox.dropped().scans), (Some(100), None, 5 + MAX_SCANS as u64));
    }

    #[test]
    fn a_full_mailbox_loses_the_oldest_events_and_counts_them() {
        let mailbox = Mailbox::default();
        for arrival in 0..MAX_EVENTS as u64 + 2 {
            mailbox.put_event(Event::Message(0, raw(arrival)));
        }
        let work = mailbox.take().unwrap();
        assert_eq!((work.events.len(), work.events.front()), (MAX_EVENTS, Some(&Event::Message(0, raw(2)))));
        assert_eq!(mailbox.dropped(), Dropped { scans: 0, events: 2 });
    }

    #[test]
    fn queued_events_take_bounded_memory() {
        let mailbox = Mailbox::default();
        for arrival in 0..5 {
            let bytes = vec![0; MAX_EVENT_BYTES / 3];
            mailbox.put_event(Event::Message(0, RawMessage { bytes, ..raw(arrival) }));
        }
        assert_eq!((mailbox.take().unwrap().events.len(), mailbox.dropped().events), (3, 2));
        mailbox.put_event(Event::Message(0, RawMessage { bytes: vec![0; MAX_EVENT_BYTES + 1], ..raw(6) }));
        mailbox.put_event(RESET);
        assert_eq!((mailbox.take().unwrap().events.len(), mailbox.dropped().events), (1, 3), "too large to be queued at all");
    }

    #[test]
    fn a_held_scan_waits_for_events_for_a_limited_time() {
        let mailbox = Mailbox::default();
        assert_eq!(mailbox.take_events(Duration::from_millis(1)), None);
        mailbox.put_event(RESET);
        assert_eq!(mailbox.take_events(Duration::from_secs(60)), Some(VecDeque::from([RESET])));
        mailbox.put_scan(raw(1));
        assert_eq!(mailbox.take_events(Duration::from_secs(60)), None, "a newer scan ends the wait");
    }

    #[test]
    fn an_empty_mailbox_does_not_delay_the_timer() {
        let mailbox = Mailbox::default();
        assert_eq!(mailbox.take_within(Duration::from_millis(1)), Some(Batch::default()));
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
