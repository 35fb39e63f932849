//! The thread of a node that answers scans: empties the mailbox, and drives what answers. A node is its [`Estimator`], its topics and a
//! launch file.

use std::sync::Arc;
use std::time::Duration;

use super::NodeError;
use super::diagnostics::{MOUNT_ASSUMED, Monitor};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::{Event, Mailbox, Work};
use super::numbering::Numbering;
use super::priority::Urgency;
use super::reader::Reader;
use super::sink::{RawMessage, Topic};
use super::subscriptions::Subscriptions;
use crate::anytime::clock::Clock;
use crate::anytime::timer::Timer;
use crate::app::MountSource;
use crate::app::sensed::Sensed;
use crate::time::Stamp;
use crate::transforms::Mount;

/// Transforms may come a little later than the first scans do.
const MOUNT_TIMEOUT: Duration = Duration::from_secs(2);

/// How a message is handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// It is answered, unless a newer one replaces it.
    Scan,
    /// It asks for the answer now.
    Interrupt,
    /// It is taken into account, in the order of arrival.
    Event,
}

/// A topic that a node listens to.
pub(super) trait NodeInput: Copy + Send + Sync + 'static {
    fn topic(self) -> Topic;

    fn kind(self) -> Kind {
        match self.topic().name {
            "scan" | "cloud" => Kind::Scan,
            "icp_interrupt" => Kind::Interrupt,
            _ => Kind::Event,
        }
    }

    /// Its name before remapping.
    fn name(self) -> &'static str {
        self.topic().name
    }
}

/// Subscribes to `input`; what comes goes into the mailbox.
pub(super) fn subscribe<I: NodeInput>(
    subscriptions: &Subscriptions,
    input: I,
    mailbox: &Arc<Mailbox<I>>,
    interrupts: &Arc<Interrupts>,
) -> Result<(), NodeError> {
    let (mailbox, interrupts) = (Arc::clone(mailbox), Arc::clone(interrupts));
    let mut numbering = Numbering::default();
    let kind = input.kind();
    let receive = move |raw: RawMessage| match kind {
        Kind::Scan => {
            mailbox.count_lost_scans(numbering.lost_before(&raw).into());
            mailbox.put_scan(raw);
        }
        Kind::Interrupt => interrupts.request(),
        Kind::Event => mailbox.put_event(Event::Message(input, raw)),
    };
    subscriptions.listen(input.topic(), receive)
}

/// What the working thread shares with the rest of the node.
pub(super) struct Shared<I> {
    pub(super) mailbox: Arc<Mailbox<I>>,
    pub(super) interrupts: Arc<Interrupts>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) monitor: Arc<Monitor>,
    pub(super) log: Log,
    /// Scans come as point clouds.
    pub(super) takes_clouds: bool,
}

/// What an estimator works with.
pub(super) struct Desk<I> {
    pub(super) mailbox: Arc<Mailbox<I>>,
    pub(super) interrupts: Arc<Interrupts>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) monitor: Arc<Monitor>,
    pub(super) log: Log,
    pub(super) reader: Reader,
    /// Of this thread.
    pub(super) urgency: Urgency,
    takes_clouds: bool,
    mount_told: Option<MountSource>,
    first_answer: Option<Duration>,
}

impl<I> Desk<I> {
    /// Of the thread that calls.
    fn new(shared: Shared<I>) -> Self {
        let Shared { mailbox, interrupts, clock, monitor, log, takes_clouds } = shared;
        let reader = Reader::new(&clock, &log).counting(&monitor);
        let urgency = Urgency::of_this_thread();
        Self { mailbox, interrupts, clock, monitor, log, reader, urgency, takes_clouds, mount_told: None, first_answer: None }
    }

    fn read_sensed(&mut self, raw: &RawMessage) -> Option<Sensed> {
        if self.takes_clouds {
            self.reader.read("cloud", raw).map(Sensed::Cloud)
        } else {
            self.reader.read("scan", raw).map(Sensed::Scan)
        }
    }

    /// Says once where the laser's place is known from, or that it is not.
    pub(super) fn watch_mount(&mut self, (mount, source): (Mount, MountSource)) {
        let now = self.clock.now();
        let waited = now.saturating_sub(*self.first_answer.get_or_insert(now));
        if self.mount_told == Some(source) || (source == MountSource::Assumed && waited < MOUNT_TIMEOUT) {
            return;
        }
        self.mount_told = Some(source);
        self.monitor.set_condition(MOUNT_ASSUMED, source == MountSource::Assumed);
        let place = mount.base_from_laser;
        let head = if mount.upside_down { ", upside down" } else { "" };
        let text = format!("[{:.3} m, {:.3} m, {:.3} rad]{head}", place.x, place.y, place.theta);
        match source {
            MountSource::Parameter => self.log.info(&format!("the laser's place on the base is {text}, by odometry.laser_in_base")),
            MountSource::Transforms => self.log.info(&format!("the laser's place on the base is {text}, by tf")),
            MountSource::Assumed => self.log.warn(
                "the laser's place on the base is not known and taken to be the base's origin: set the parameter \
                 odometry.laser_in_base to [x, y, yaw], or publish the transform from the base frame to the laser's on /tf_static",
            ),
        }
    }

    /// Says what is odd in the scans.
    pub(super) fn tell(&self, remarks: Vec<String>) {
        for remark in remarks {
            self.log.warn(&format!("scan: {remark}"));
        }
    }
}

/// The algorithm of a node.
pub(super) trait Estimator {
    /// Its inputs.
    type Input: NodeInput;
    /// Whether a scan is to wake the thread at once, before all programs of normal priority; else what came with it is heard first.
    const WAKES_AT_ONCE: bool;

    /// Before anything else, in the thread that works.
    fn begin(&mut self, _: &mut Desk<Self::Input>) {}

    /// Takes anything but a scan.
    fn handle(&mut self, event: Event<Self::Input>, desk: &mut Desk<Self::Input>);

    /// How long to hold back a scan of this stamp for odometry; `None`: answer it now.
    fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration>;

    /// How long a scan may wait in line while those before it are answered; for none: a newer one takes its place.
    fn patience_in_line(&self) -> Duration {
        Duration::ZERO
    }

    /// Answers a scan that arrived when the clock read `arrival`.
    fn answer(&mut self, scan: &Sensed, arrival: Duration, desk: &mut Desk<Self::Input>);

    /// The timer calls, and there is no scan.
    fn carry_on(&mut self) {}

    /// The node is ending.
    fn end(&mut self, _: &Desk<Self::Input>) {}
}

/// A node's thread.
pub(super) struct Worker<E: Estimator> {
    estimator: E,
    desk: Desk<E::Input>,
    /// The newest scan, until the timer calls for an answer.
    held: Option<RawMessage>,
}

impl<E: Estimator> Worker<E> {
    /// For the thread that calls.
    pub(super) fn new(estimator: E, shared: Shared<E::Input>) -> Self {
        Self { estimator, desk: Desk::new(shared), held: None }
    }

    /// Works until the mailbox is closed. Scans are answered as they come, or when the timer calls.
    pub(super) fn run(mut self, mut timer: Option<Timer>) {
        if !self.desk.urgency.is_permitted() {
            self.desk
                .log
                .info("real-time priority is not permitted (CAP_SYS_NICE, or ulimit -r): busy programs can make answers late");
        }
        self.desk.urgency.set(false);
        self.estimator.begin(&mut self.desk);
        while let Some(Work { events, scan }) = self.next_work(timer.as_ref()) {
            self.handle(events);
            if let Some(scan) = scan {
                let unused = self.held.replace(scan).is_some();
                self.desk.mailbox.count_lost_scans(unused.into());
            }
            let now = self.desk.clock.now();
            if timer.as_mut().is_none_or(|timer| timer.is_due(now)) {
                match self.held.take() {
                    // Where a timer calls for the answer, the time counts from its call.
                    Some(raw) => self.answer(&raw, if timer.is_some() { now } else { raw.arrival }),
                    None if timer.is_some() => self.estimator.carry_on(),
                    None => {}
                }
            }
            self.desk.urgency.set(E::WAKES_AT_ONCE);
        }
        self.estimator.end(&self.desk);
    }

    fn next_work(&self, timer: Option<&Timer>) -> Option<Work<E::Input>> {
        self.desk.mailbox.set_patience(self.estimator.patience_in_line());
        match timer {
            Some(timer) => self.desk.mailbox.take_within(timer.left(self.desk.clock.now())),
            None => self.desk.mailbox.take(),
        }
    }

    fn handle(&mut self, events: impl IntoIterator<Item = Event<E::Input>>) {
        for event in events {
            self.estimator.handle(event, &mut self.desk);
        }
    }

    fn answer(&mut self, raw: &RawMessage, arrival: Duration) {
        self.desk.interrupts.begin();
        match self.desk.read_sensed(raw) {
            Some(scan) => {
                self.await_odometry(scan.stamp(), arrival);
                self.estimator.answer(&scan, arrival, &mut self.desk);
            }
            None => self.desk.interrupts.abandon(),
        }
    }

    /// Holds a scan back while the estimator wants to see more odometry first.
    fn await_odometry(&mut self, stamp: Stamp, arrival: Duration) {
        while let Some(longest) = self.estimator.wait_for_odometry(stamp) {
            let left = (arrival + longest).saturating_sub(self.desk.clock.now());
            let Some(events) = self.desk.mailbox.events_for_held_scan(left, &*self.desk.interrupts) else { return };
            self.handle(events);
        }
    }
}
