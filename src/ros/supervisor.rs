//! What looks after a node that has one thread for its work: signals, the master, the diagnostics.

use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::diagnostics::{self, Diagnostics, Monitor};
use super::log::Log;
use super::mailbox::Mailbox;
use super::master::{MasterLink, MasterRegistration};
use super::services::Service;
use super::shutdown::StopSignal;
use super::subscriptions::Subscriptions;
use crate::anytime::clock::Clock;

/// How often the node looks whether it is to stop.
const TICK: Duration = Duration::from_millis(100);

/// What a node is made of.
pub(super) struct Parts<'a, I> {
    pub(super) clock: Arc<dyn Clock>,
    pub(super) mailbox: Arc<Mailbox<I>>,
    pub(super) monitor: Arc<Monitor>,
    pub(super) diagnostics: Diagnostics,
    /// Ends when the mailbox is closed.
    pub(super) worker: JoinHandle<()>,
    pub(super) subscriptions: Subscriptions<'a>,
    pub(super) services: Vec<Service>,
    /// How its topics are registered with the master.
    pub(super) registrations: Vec<MasterRegistration>,
}

/// Starts the thread that does the work.
pub(super) fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, NodeError> {
    let thread = thread::Builder::new().name(name.into()).spawn(work);
    thread.map_err(|problem| NodeError::System { action: "start a thread", problem })
}

/// Looks after a node.
pub(super) struct Supervisor<'a, I> {
    ros: &'a Ros,
    parts: Parts<'a, I>,
    master: MasterLink<'a>,
}

impl<'a, I> Supervisor<'a, I> {
    /// Knows how the node is registered with the master.
    pub(super) fn new(ros: &'a Ros, master: &'a Master, mut parts: Parts<'a, I>, log: &Log) -> Result<Self, NodeError> {
        let mut registrations = std::mem::take(&mut parts.registrations);
        registrations.extend([parts.diagnostics.registration(), MasterRegistration::ROSOUT]);
        for service in &parts.services {
            registrations.push(service.registration(ros)?);
        }
        let master = MasterLink::new(ros, master, registrations, log)?;
        Ok(Self { ros, parts, master })
    }

    /// Once a second: the master, what else there is to `care` for while it answers, and the diagnostics. Runs until it is told to
    /// stop.
    pub(super) fn run(mut self, stop: &StopSignal, mut care: impl FnMut(&mut MasterLink)) {
        let parts = &mut self.parts;
        let mut last = parts.clock.now();
        while !stop.wait(TICK) && self.ros.is_ok() {
            let elapsed = parts.clock.now().saturating_sub(last);
            if elapsed >= diagnostics::PERIOD {
                last = parts.clock.now();
                self.master.check();
                if self.master.is_present() {
                    care(&mut self.master);
                }
                parts.monitor.set_too_long(parts.subscriptions.refused());
                let (dropped, present) = (parts.mailbox.dropped(), self.master.is_present());
                parts.diagnostics.publish(self.ros, &parts.monitor, dropped, present, elapsed.as_secs_f64());
            }
        }
        self.parts.mailbox.close();
        let _ = self.parts.worker.join(); // a panic there has been reported by now
    }
}
