//! The thread of a node: empties the mailbox, and drives the node's algorithm. A node is its [`Algorithm`], its topics and a launch
//! file.

use std::time::Duration;

use super::context::Context;
use super::input::{Handling, Input};
use super::mailbox::{Event, Request, Work};
use super::sink::RawMessage;
use crate::anytime::timer::Timer;
use crate::app::sensed::Sensed;
use crate::time::Stamp;

/// The algorithm of a node. What it does with the messages of its topics is in its [`Input`]s.
pub(super) trait Algorithm {
    /// Whether a scan is to wake the thread at once, before all programs of normal priority; else what came with it is heard first.
    const WAKES_AT_ONCE: bool = false;

    /// Before anything else, in the thread that works.
    fn begin(&mut self, _: &mut Context) {}

    /// Does what is asked by a service or a parameter.
    fn request(&mut self, _: Request, _: &mut Context) {}

    /// How long to hold back a scan of this stamp for odometry; `None`: answer it now.
    fn wait_for_odometry(&self, _: Stamp) -> Option<Duration> {
        None
    }

    /// How long a scan may wait in line while those before it are answered; for none: a newer one takes its place.
    fn patience_in_line(&self) -> Duration {
        Duration::ZERO
    }

    /// Answers a scan that arrived when the clock read `arrival`.
    fn answer(&mut self, _scan: &Sensed, _arrival: Duration, _: &mut Context) {}

    /// The timer calls, and there is no scan.
    fn carry_on(&mut self, _: &mut Context) {}

    /// The node is ending.
    fn end(&mut self, _: &Context) {}
}

/// A node's thread.
pub(super) struct Worker<A> {
    algorithm: A,
    inputs: Vec<Input<A>>,
    context: Context,
    /// The newest scan, until the timer calls for an answer.
    held: Option<RawMessage>,
}

impl<A: Algorithm> Worker<A> {
    /// For the thread that calls.
    pub(super) fn new(algorithm: A, inputs: Vec<Input<A>>, context: Context) -> Self {
        Self { algorithm, inputs, context, held: None }
    }

    /// Works until the mailbox is closed. Scans are answered as they come, or when the timer calls.
    pub(super) fn run(mut self, mut timer: Option<Timer>) {
        self.context.urgency.set(false);
        self.algorithm.begin(&mut self.context);
        while let Some(Work { events, scan }) = self.next_work(timer.as_ref()) {
            self.handle(events);
            if let Some(scan) = scan {
                let unused = self.held.replace(scan).is_some();
                self.context.shared.mailbox.count_lost_scans(unused.into());
            }
            let now = self.context.shared.clock.now();
            if timer.as_mut().is_none_or(|timer| timer.is_due(now)) {
                match self.held.take() {
                    // Where a timer calls for the answer, the time counts from its call.
                    Some(raw) => self.answer(&raw, if timer.is_some() { now } else { raw.arrival }),
                    None if timer.is_some() => self.algorithm.carry_on(&mut self.context),
                    None => {}
                }
            }
            self.context.urgency.set(A::WAKES_AT_ONCE);
        }
        self.algorithm.end(&self.context);
    }

    fn next_work(&self, timer: Option<&Timer>) -> Option<Work> {
        self.context.shared.mailbox.set_patience(self.algorithm.patience_in_line());
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
        match self.read_sensed(raw) {
            Some(scan) => {
                self.await_odometry(scan.stamp(), arrival);
                self.algorithm.answer(&scan, arrival, &mut self.context);
            }
            None => self.context.shared.interrupts.abandon(),
        }
    }

    fn read_sensed(&mut self, raw: &RawMessage) -> Option<Sensed> {
        if self.inputs.iter().any(|input| matches!(input.handling, Handling::Cloud)) {
            self.context.reader.read("cloud", raw).map(Sensed::Cloud)
        } else {
            self.context.reader.read("scan", raw).map(Sensed::Scan)
        }
    }

    /// Holds a scan back while the algorithm wants to see more odometry first.
    fn await_odometry(&mut self, stamp: Stamp, arrival: Duration) {
        while let Some(longest) = self.algorithm.wait_for_odometry(stamp) {
            let left = (arrival + longest).saturating_sub(self.context.shared.clock.now());
            let Some(events) = self.context.shared.mailbox.events_for_held_scan(left, &*self.context.shared.interrupts) else {
                return;
            };
            self.handle(events);
        }
    }
}
