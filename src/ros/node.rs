//! What all nodes have in common: their parts, the thread that works, and what looks after it: signals, the master, the diagnostics.

use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::context::{Context, Shared};
use super::diagnostics::{self, Diagnostics, Monitor, Task};
use super::input::{Handling, Input};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::{Event, Mailbox};
use super::master::{MasterLink, MasterRegistration, connect, note, wait_for_master};
use super::node_api;
use super::numbering::Numbering;
use super::services::Service;
use super::shutdown::StopSignal;
use super::sink::RawMessage;
use super::subscriptions::Subscriptions;
use super::worker::{Algorithm, Worker};
use crate::anytime::clock::MonotonicClock;
use crate::anytime::timer::Timer;

/// How often the node looks whether it is to stop.
const TICK: Duration = Duration::from_millis(100);

/// Runs `serve` as the ROS node `name` once there is a master; returns early when the node is to stop before. The arguments of the
/// process are ROS's: remappings and parameters.
pub(super) fn run(name: &str, serve: impl FnOnce(&Ros, &Master, &StopSignal) -> Result<(), NodeError>) -> Result<(), NodeError> {
    let stop = StopSignal::install()?;
    node_api::start()?;
    if !wait_for_master(name, &stop)? {
        return Ok(());
    }
    let ros = Ros::new(name).map_err(|error| NodeError::ros("start as a ROS node", &error))?;
    let outcome = connect(ros.name(), ros.uri()).and_then(|master| serve(&ros, &master, &stop));
    ros.shutdown_sender().shutdown(); // removes the last registration with the master: rosrust's own publisher of /rosout
    outcome
}

/// Starts a thread.
pub(super) fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, NodeError> {
    thread::Builder::new().name(name.into()).spawn(work).map_err(no_thread)
}

/// The parts of a node, until it starts.
pub(super) struct NodeParts<'a> {
    ros: &'a Ros,
    master: &'a Master,
    pub(super) shared: Shared,
    pub(super) services: Vec<Service>,
    diagnostics: Option<Diagnostics>,
}

impl<'a> NodeParts<'a> {
    /// Without services and published topics so far.
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

    /// Reports on `/diagnostics` how the node does its task.
    pub(super) fn diagnose(&mut self, task: Task) -> Result<(), NodeError> {
        self.diagnostics = Some(Diagnostics::new(self.ros, task)?);
        Ok(())
    }

    /// Subscribes to the inputs. The thread that works is called `name`.
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
            registrations.push(note(ros, input.topic.registration())?);
        }
        let of_worker = shared.clone();
        let work = Box::new(move || Worker::new(algorithm, inputs, Context::new(of_worker)).run(timer));
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

/// Subscribes to an input; what comes goes into the mailbox.
fn subscribe<A>(subscriptions: &Subscriptions, index: usize, input: &Input<A>, shared: &Shared) -> Result<(), NodeError> {
    let (mailbox, interrupts) = (Arc::clone(&shared.mailbox), Arc::clone(&shared.interrupts));
    let mut numbering = Numbering::default();
    match input.handling {
        Handling::Scan | Handling::Cloud => subscriptions.listen(input.topic, move |raw: RawMessage| {
            mailbox.count_lost_scans(numbering.lost_before(&raw).into());
            mailbox.put_scan(raw);
        }),
        Handling::Interrupt => subscriptions.listen(input.topic, move |_| interrupts.request()),
        Handling::Event(_) => subscriptions.listen(input.topic, move |raw| mailbox.put_event(Event::Message(index, raw))),
    }
}

/// A node that is ready to run.
pub(super) struct Node<'a> {
    ros: &'a Ros,
    master: MasterLink<'a>,
    shared: Shared,
    diagnostics: Option<Diagnostics>,
    subscriptions: Subscriptions<'a>,
    // Dropping these ends them.
    _services: Vec<Service>,
    _registrations: Vec<Arc<MasterRegistration>>,
    thread: &'static str,
    /// What the thread does; ends when the mailbox is closed.
    work: Option<Work<'a>>,
}

type Work<'a> = Box<dyn FnOnce() + Send + 'a>;

impl Node<'_> {
    /// Runs until it is told to stop. Once a second it looks after the master, does what else there is to `care` for while that
    /// answers, and reports how it is doing.
    pub(super) fn run(mut self, stop: &StopSignal, care: impl FnMut()) -> Result<(), NodeError> {
        let Some(work) = self.work.take() else { return Ok(()) };
        thread::scope(|scope| {
            let worker = thread::Builder::new().name(self.thread.into()).spawn_scoped(scope, work).map_err(no_thread)?;
            self.look_after(stop, care);
            self.shared.mailbox.close();
            let _ = worker.join(); // a panic there has been reported by now
            Ok(())
        })
    }

    fn look_after(&mut self, stop: &StopSignal, mut care: impl FnMut()) {
        let mut last = self.shared.clock.now();
        while !stop.wait(TICK) && self.ros.is_ok() {
            let elapsed = self.shared.clock.now().saturating_sub(last);
            if elapsed >= diagnostics::PERIOD {
                last += elapsed;
                self.master.check();
                if self.master.is_present() {
                    care();
                }
                self.diagnose(elapsed);
            }
        }
    }

    fn diagnose(&mut self, elapsed: Duration) {
        let Some(diagnostics) = &mut self.diagnostics else { return };
        let Shared { mailbox, monitor, .. } = &self.shared;
        monitor.set_too_long(self.subscriptions.refused());
        diagnostics.publish(self.ros, monitor, mailbox.dropped(), self.master.is_present(), elapsed.as_secs_f64());
    }
}

fn no_thread(problem: std::io::Error) -> NodeError {
    NodeError::System { action: "start a thread", problem }
}
