//! What looks after a node that has one thread for its work: signals, the master, the diagnostics.

use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rosrust::api::{Master, Ros};
use rosrust::{Service, Subscriber};
use rosrust_msg::std_srvs::{Trigger, TriggerRes};

use super::NodeError;
use super::diagnostics::{self, Diagnostics, Monitor};
use super::log::{Log, ROSOUT};
use super::mailbox::{Event, Mailbox};
use super::master::{Change, MasterLink, Role};
use super::shutdown::StopSignal;
use crate::anytime::clock::Clock;

/// How often the node looks whether it is to stop.
const TICK: Duration = Duration::from_millis(100);

/// A service of a node, by which [`Event::Reset`] gets into its mailbox.
#[derive(Clone, Copy)]
pub(super) struct Call {
    pub(super) name: &'static str,
    /// What the caller is told.
    pub(super) answer: &'static str,
}

/// What a node is made of.
pub(super) struct Parts<I> {
    pub(super) clock: Arc<dyn Clock>,
    pub(super) mailbox: Arc<Mailbox<I>>,
    pub(super) monitor: Arc<Monitor>,
    pub(super) diagnostics: Diagnostics,
    /// Ends when the mailbox is closed.
    pub(super) worker: JoinHandle<()>,
    pub(super) log: Log,
    pub(super) subscribers: Vec<Subscriber>,
    /// How its topics stand in the master's books.
    pub(super) roles: Vec<Role>,
}

/// Starts the thread that does the work.
pub(super) fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, NodeError> {
    let thread = thread::Builder::new().name(name.into()).spawn(work);
    thread.map_err(|problem| NodeError::System { action: "start a thread", problem })
}

/// Looks after a node.
pub(super) struct Supervisor<'a, I> {
    ros: &'a Ros,
    parts: Parts<I>,
    master: MasterLink<'a>,
    call: Call,
    service: Option<Service>,
    // Dropping these ends them.
    _subscribers: Vec<Subscriber>,
}

impl<'a, I: Send + 'static> Supervisor<'a, I> {
    /// Makes the node known to the master, and offers its service.
    pub(super) fn new(ros: &'a Ros, master: &'a Master, mut parts: Parts<I>, call: Call) -> Result<Self, NodeError> {
        let service = Some(offer(ros, call, &parts.mailbox)?);
        let subscribers = std::mem::take(&mut parts.subscribers);
        let mut roles = std::mem::take(&mut parts.roles);
        roles.extend([parts.diagnostics.role(), Role::Publisher { topic: ROSOUT, message_type: "rosgraph_msgs/Log".into() }]);
        let master = MasterLink::new(ros, master, roles, &parts.log)?;
        Ok(Self { ros, parts, master, call, service, _subscribers: subscribers })
    }

    /// Once a second: the master and the diagnostics. Until somebody wants the node to stop.
    pub(super) fn run(mut self, stop: &StopSignal) {
        let mut last = self.parts.clock.now();
        while !stop.wait(TICK) && self.ros.is_ok() {
            let elapsed = self.parts.clock.now().saturating_sub(last);
            if elapsed >= diagnostics::PERIOD {
                last = self.parts.clock.now();
                self.look_after_master();
                let (dropped, present) = (self.parts.mailbox.dropped(), self.master.is_present());
                self.parts.diagnostics.publish(self.ros, &self.parts.monitor, dropped, present, elapsed.as_secs_f64());
            }
        }
        self.parts.mailbox.close();
        let _ = self.parts.worker.join(); // a panic there has been reported by now
    }

    fn look_after_master(&mut self) {
        if self.master.check() == Change::Returned {
            self.service = None; // the old one must be gone before its name can be used again
            match offer(self.ros, self.call, &self.parts.mailbox) {
                Ok(service) => self.service = Some(service),
                Err(error) => self.parts.log.warn(&error.to_string()),
            }
        }
    }
}

fn offer<I: Send + 'static>(ros: &Ros, call: Call, mailbox: &Arc<Mailbox<I>>) -> Result<Service, NodeError> {
    let mailbox = Arc::clone(mailbox);
    let handle = move |_| {
        mailbox.put_event(Event::Reset);
        Ok(TriggerRes { success: true, message: call.answer.into() })
    };
    ros.service::<Trigger, _>(call.name, handle)
        .map_err(|error| NodeError::ros(format!("offer the service '{}'", call.name), &error))
}
