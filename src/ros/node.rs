//! What all nodes have in common: setup, the worker thread, and the main thread that handles signals, the master and diagnostics.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::context::{Context, Shared};
use super::diagnostics::{self, Diagnostics, Monitor, TaskWording};
use super::input::{Handling, Input};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::{Event, Mailbox};
use super::master::{MasterLink, MasterRegistration, connect, track_registration, wait_for_master};
use super::node_api;
use super::sequence::SequenceTracker;
use super::services::Service;
use super::shutdown::StopSignal;
use super::sink::RawMessage;
use super::subscriptions::Subscriptions;
use super::threads::spawn_scoped;
use super::worker::{Algorithm, Worker};
use crate::anytime::clock::MonotonicClock;
use crate::anytime::timer::Timer;

/// Time between two checks for a request to stop.
const TICK: Duration = Duration::from_millis(100);

/// Runs `serve` as the ROS node `name` as soon as there is a master; returns early if a signal stops the node before that. The
/// process arguments are those of ROS: remappings and private parameters.
pub(super) fn run(name: &str, serve: impl FnOnce(&Ros, &Master, &StopSignal) -> Result<(), NodeError>) -> Result<(), NodeError> {
    let stop = StopSignal::install()?;
    node_api::start()?;
    if !wait_for_master(name, &stop)? {
        return Ok(());
    }
    let ros = Ros::new(name).map_err(|error| NodeError::ros("start as a ROS node", &error))?;
    let outcome = connect(ros.name(), ros.uri()).and_then(|master| serve(&ros, &master, &stop));
    ros.shutdown_sender().shutdown(); // removes the last registration from the master: rosrust's own publisher of /rosout
    outcome
}

/// The parts of a node that has not been built yet.
pub(super) struct NodeParts<'a> {
    ros: &'a Ros,
    master: &'a Master,
    pub(super) shared: Shared,
    pub(super) services: Vec<Service>,
    diagnostics: Option<Diagnostics>,
}

impl<'a> NodeParts<'a> {
    /// Starts without services and published topics.
    pub(super) fn new(ros: &'a Ros, master: &'a Master) -> Result<Self, NodeError> {
        let shared = Shared {
            mailbox: Arc::new(Mailbox::default()),
            interrupts: Arc::new(Interrupts::new(None)?),
            clock: Arc::new(MonotonicClock::default()),
            monitor: Arc::new(Monitor::default()),
            log: Log::new(ros)?,
        };
        Ok(Self { ros, master, shared, services: Vec::new(), diagnostics: None })
    }

    /// Makes the node report its state on `/diagnostics`.
    pub(super) fn diagnose(&mut self, task: TaskWording) -> Result<(), NodeError> {
        self.diagnostics = Some(Diagnostics::new(self.ros, task)?);
        Ok(())
    }

    /// Subscribes to the inputs. `name` is the name of the worker thread.
    pub(super) fn build<A: Algorithm + Send + 'a>(
        self,
        name: &'static str,
        algorithm: A,
        inputs: Vec<Input<A>>,
        timer: Option<Timer>,
    ) -> Result<Node<'a>, NodeError> {
        let Self { ros, master, shared, services, diagnostics } = self;
        let subscriptions = Subscriptions::new(ros, &shared.clock, &shared.log)?;
        let mut registrations = Vec::new();
        for (index, input) in inputs.iter().enumerate() {
            subscribe(&subscriptions, index, input, &shared)?;
            registrations.push(track_registration(ros, input.topic.registration())?);
        }
        let worker_shared = shared.clone();
        let work = Box::new(move || Worker::new(algorithm, inputs, Context::new(worker_shared)).run(timer));
        let master = MasterLink::new(ros, master, &shared.log)?;
        Ok(Node {
            ros,
            master,
            shared,
            diagnostics,
            subscriptions,
            _services: services,
            _registrations: registrations,
            thread: name,
            work: Some(work),
        })
    }
}

/// Subscribes to an input and delivers its messages to the mailbox.
fn subscribe<A>(subscriptions: &Subscriptions, index: usize, input: &Input<A>, shared: &Shared) -> Result<(), NodeError> {
    let (mailbox, interrupts) = (Arc::clone(&shared.mailbox), Arc::clone(&shared.interrupts));
    let mut sequence = SequenceTracker::default();
    match input.handling {
        Handling::Scan | Handling::Cloud => subscriptions.subscribe(input.topic, move |raw: RawMessage| {
            mailbox.count_dropped_scans(sequence.lost_before(&raw).into());
            mailbox.put_scan(raw);
        }),
        Handling::Interrupt => subscriptions.subscribe(input.topic, move |_| interrupts.request()),
        Handling::Event(_) => subscriptions.subscribe(input.topic, move |raw| mailbox.put_event(Event::Message(index, raw))),
    }
}

/// A node that is ready to run.
pub(super) struct Node<'a> {
    ros: &'a Ros,
    master: MasterLink<'a>,
    shared: Shared,
    diagnostics: Option<Diagnostics>,
    subscriptions: Subscriptions<'a>,
    // Services and registrations end when they are dropped.
    _services: Vec<Service>,
    _registrations: Vec<Arc<MasterRegistration>>,
    thread: &'static str,
    /// Body of the worker thread; returns when the mailbox is closed.
    work: Option<ThreadBody<'a>>,
}

type ThreadBody<'a> = Box<dyn FnOnce() + Send + 'a>;

impl Node<'_> {
    /// Runs until a signal or the master stops the node. Once a second it checks the master, calls `maintain` if the master
    /// answers, and publishes diagnostics.
    pub(super) fn run(mut self, stop: &StopSignal, maintain: impl FnMut()) -> Result<(), NodeError> {
        let Some(work) = self.work.take() else { return Ok(()) };
        thread::scope(|scope| {
            let worker = spawn_scoped(scope, self.thread, work)?;
            self.supervise(stop, maintain);
            self.shared.mailbox.close();
            let _ = worker.join(); // a panic of the worker has already been printed
            Ok(())
        })
    }

    fn supervise(&mut self, stop: &StopSignal, mut maintain: impl FnMut()) {
        let mut last = self.shared.clock.now();
        while !stop.wait(TICK) && self.ros.is_ok() {
            let elapsed = self.shared.clock.now().saturating_sub(last);
            if elapsed >= diagnostics::PERIOD {
                last += elapsed;
                self.master.check();
                if self.master.is_present() {
                    maintain();
                }
                self.diagnose(elapsed);
            }
        }
    }

    fn diagnose(&mut self, elapsed: Duration) {
        let Some(diagnostics) = &mut self.diagnostics else { return };
        let Shared { mailbox, monitor, .. } = &self.shared;
        monitor.set_oversized(self.subscriptions.oversized());
        diagnostics.publish(self.ros, monitor, mailbox.dropped(), self.master.is_present(), elapsed.as_secs_f64());
    }
}
