//! The worker thread of a node: it empties the mailbox and calls the node's algorithm. A node consists of its [`Algorithm`], its
//! topics and a launch file.

use std::time::Duration;

use super::context::Context;
use super::input::{Handling, Input};
use super::mailbox::{Batch, Event, Request};
use super::sink::RawMessage;
use crate::anytime::timer::Timer;
use crate::app::sensed::SensorMessage;
use crate::messages::std_msgs::Header;

/// The algorithm of a node. The handlers of its topics are in its [`Input`]s.
pub(super) trait Algorithm {
    /// Whether the thread waits with real-time priority, so that a scan wakes it at once. If not, messages that come with the
    /// scan are handled before it.
    const REAL_TIME_WAKEUP: bool = false;

    /// Called once in the worker thread, before anything else.
    fn begin(&mut self, _: &mut Context) {}

    /// Handles a request by a service or a parameter.
    fn request(&mut self, _: Request, _: &mut Context) {}

    /// How long to hold back the scan with this header for odometry or transforms; `None`: process it now.
    fn wait_for_inputs(&self, _: &Header) -> Option<Duration> {
        None
    }

    /// Maximum wait of a scan in the queue. Zero: only the latest scan is processed.
    fn max_queue_time(&self) -> Duration {
        Duration::ZERO
    }

    /// Processes a scan that arrived at the time `arrival` and publishes the answer.
    fn answer(&mut self, _scan: &SensorMessage, _arrival: Duration, _: &mut Context) {}

    /// Called when the timer expires and there is no scan.
    fn on_timer(&mut self, _: &mut Context) {}

    /// Called once before the node ends.
    fn end(&mut self, _: &Context) {}
}

/// The worker thread of a node.
pub(super) struct Worker<A> {
    algorithm: A,
    inputs: Vec<Input<A>>,
    context: Context,
    /// The latest scan, which is processed when the timer expires.
    pending: Option<RawMessage>,
}

impl<A: Algorithm> Worker<A> {
    /// To be called in the worker thread.
    pub(super) fn new(algorithm: A, inputs: Vec<Input<A>>, context: Context) -> Self {
        Self { algorithm, inputs, context, pending: None }
    }

    /// Runs until the mailbox is closed. Scans are processed as they come or, with a timer, when it expires.
    pub(super) fn run(mut self, mut timer: Option<Timer>) {
        self.context.real_time.set(false);
        self.algorithm.begin(&mut self.context);
        while let Some(Batch { events, scan }) = self.next_batch(timer.as_ref()) {
            self.handle(events);
            if let Some(scan) = scan {
                let is_replaced = self.pending.replace(scan).is_some();
                self.context.shared.mailbox.count_dropped_scans(is_replaced.into());
            }
            let now = self.context.shared.clock.now();
            if timer.as_mut().is_none_or(|timer| timer.is_due(now)) {
                match self.pending.take() {
                    // With a timer, the elapsed time counts from its expiry.
                    Some(raw) => self.answer(&raw, if timer.is_some() { now } else { raw.arrival }),
                    None if timer.is_some() => self.algorithm.on_timer(&mut self.context),
                    None => {}
                }
            }
            self.context.real_time.set(A::REAL_TIME_WAKEUP);
        }
        self.algorithm.end(&self.context);
    }

    fn next_batch(&self, timer: Option<&Timer>) -> Option<Batch> {
        self.context.shared.mailbox.set_max_wait(self.algorithm.max_queue_time());
        match timer {
            Some(timer) => self.context.shared.mailbox.take_within(timer.left(self.context.shared.clock.now())),
            None => self.context.shared.mailbox.take(),
        }
    }

    fn handle(&mut self, events: impl IntoIterator<Item = Event>) {
        for event in events {
            match event {
                Event::Request(request) => self.algorithm.request(request, &mut self.context),
                Event::Message(input, raw) => {
                    if let Some(Input { handling: Handling::Event(handle), .. }) = self.inputs.get(input) {
                        handle(&mut self.algorithm, &raw, &mut self.context);
                    }
                }
            }
        }
    }

    fn answer(&mut self, raw: &RawMessage, arrival: Duration) {
        self.context.shared.interrupts.begin();
        match self.read_sensor_message(raw) {
            Some(scan) => {
                self.await_inputs(scan.header(), arrival);
                self.algorithm.answer(&scan, arrival, &mut self.context);
            }
            None => self.context.shared.interrupts.abandon(),
        }
    }

    fn read_sensor_message(&mut self, raw: &RawMessage) -> Option<SensorMessage> {
        if self.inputs.iter().any(|input| matches!(input.handling, Handling::Cloud)) {
            self.context.reader.read("cloud", raw).map(SensorMessage::Cloud)
        } else {
            self.context.reader.read("scan", raw).map(SensorMessage::Scan)
        }
    }

    /// Holds a scan back while the algorithm waits for what it needs.
    fn await_inputs(&mut self, header: &Header, arrival: Duration) {
        while let Some(max_wait) = self.algorithm.wait_for_inputs(header) {
            let left = (arrival + max_wait).saturating_sub(self.context.shared.clock.now());
            let Some(events) = self.context.shared.mailbox.events_for_held_scan(left, &*self.context.shared.interrupts) else {
                return;
            };
            self.handle(events);
        }
    }
}
