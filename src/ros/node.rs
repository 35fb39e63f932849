//! The node as a whole: puts the parts together and looks after them.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use rosrust::Service;
use rosrust::api::{Master, Ros};
use rosrust_msg::std_srvs::{Trigger, TriggerRes};

use super::NodeError;
use super::diagnostics::{self, Diagnostics, Monitor};
use super::interrupts::Interrupts;
use super::links::Links;
use super::log::{Log, ROSOUT};
use super::mailbox::{Event, Mailbox};
use super::master::{MasterLink, Role, resolved};
use super::matcher::Matcher;
use super::publishers::Publishers;
use super::shutdown::StopSignal;
use super::subscriptions::{Input, subscribe};
use super::{params, shell};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::contract::Contract;
use crate::app::App;
use crate::config::Config;

const NAME: &str = "scan_matcher";
const RESET: &str = "~reset";
/// How often the node looks whether it is to stop.
const TICK: Duration = Duration::from_millis(100);

/// Runs the node `scan_matcher` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    shell::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let config = params::read(master, ros.name())?;
    Node::start(ros, master, &config)?.supervise(stop);
    Ok(())
}

struct Node<'a> {
    ros: &'a Ros,
    clock: Arc<dyn Clock>,
    mailbox: Arc<Mailbox>,
    monitor: Arc<Monitor>,
    diagnostics: Diagnostics,
    master: MasterLink<'a>,
    matching: thread::JoinHandle<()>,
    links: Links<'a>,
    // Dropping it ends it.
    _reset: Service,
}

impl<'a> Node<'a> {
    fn start(ros: &'a Ros, master: &'a Master, config: &Config) -> Result<Self, NodeError> {
        let log = Log::new(ros)?;
        let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
        let (mailbox, monitor) = (Arc::new(Mailbox::default()), Arc::new(Monitor::default()));
        let interrupts = Arc::new(Interrupts::new(config.contract.shared_memory.as_deref())?);
        let mut app = App::new(config, Arc::clone(&clock))?;
        app.warm_up()?;
        app.set_interrupt(Arc::clone(&interrupts) as Arc<_>);
        let publishers = Publishers::new(ros, config.frames.publish_tf)?;
        let diagnostics = Diagnostics::new(ros)?;
        let mut roles = publishers.roles();
        roles.extend(Input::ALL.map(|input| input.topic().role()));
        roles.extend([diagnostics.role(), Role::Publisher { topic: ROSOUT, message_type: "rosgraph_msgs/Log".into() }]);
        let contract = app.contract();

        let (in_box, time) = (Arc::clone(&mailbox), Arc::clone(&clock));
        let matcher = Matcher::new(app, publishers, in_box, Arc::clone(&interrupts), time, Arc::clone(&monitor), log.clone());
        let matching = thread::Builder::new()
            .name("matching".into())
            .spawn(|| matcher.run())
            .map_err(|problem| NodeError::System { action: "start a thread", problem })?;
        let links = Links::new(ros, &clock, &log)?;
        Input::ALL.into_iter().try_for_each(|input| subscribe(&links, input, &mailbox, &interrupts))?;
        let reset = offer_reset(ros, &mailbox)?;
        roles.push(Role::of_service(ros, RESET)?);
        let master = MasterLink::new(ros, master, roles, &log)?;
        announce(ros, &log, config, &contract)?;
        Ok(Self { ros, clock, mailbox, monitor, diagnostics, master, matching, links, _reset: reset })
    }

    /// Once a second: the master and the diagnostics. Until somebody wants the node to stop.
    fn supervise(mut self, stop: &StopSignal) {
        let mut last = self.clock.now();
        while !stop.wait(TICK) && self.ros.is_ok() {
            let elapsed = self.clock.now().saturating_sub(last);
            if elapsed >= diagnostics::PERIOD {
                last = self.clock.now();
                self.master.check();
                self.monitor.set_too_long(self.links.refused());
                let (dropped, present) = (self.mailbox.dropped(), self.master.is_present());
                self.diagnostics.publish(self.ros, &self.monitor, dropped, present, elapsed.as_secs_f64());
            }
        }
        self.mailbox.close();
        let _ = self.matching.join(); // a panic there has been reported by now
    }
}

fn offer_reset(ros: &Ros, mailbox: &Arc<Mailbox>) -> Result<Service, NodeError> {
    let mailbox = Arc::clone(mailbox);
    let handle = move |_| {
        mailbox.put_event(Event::Reset);
        Ok(TriggerRes { success: true, message: "the next scan is the first one, at the initial pose".into() })
    };
    ros.service::<Trigger, _>(RESET, handle).map_err(|error| NodeError::ros(format!("offer the service '{RESET}'"), &error))
}

/// Says that the node is ready, and what for.
fn announce(ros: &Ros, log: &Log, config: &Config, contract: &Contract) -> Result<(), NodeError> {
    let [scan, odometry, pose] = ["scan", "odom", "scan_match_location"].map(|topic| resolved(ros, topic));
    let frames = &config.frames;
    log.info(&format!(
        "matches {} with {} to {} ({} -> {}{}), {}",
        scan?,
        odometry?,
        pose?,
        frames.odom_frame,
        frames.base_frame,
        if frames.publish_tf { ", also on /tf" } else { "" },
        describe(contract),
    ));
    Ok(())
}

fn describe(contract: &Contract) -> String {
    let limits: Vec<String> = [
        contract.time_budget.map(|budget| format!("within {budget:?}")),
        contract.translation_error_bound.map(|bound| format!("to {bound} m")),
        contract.rotation_error_bound.map(|bound| format!("to {bound} rad")),
    ]
    .into_iter()
    .flatten()
    .collect();
    if limits.is_empty() { "to completion".into() } else { limits.join(", ") }
}
