//! The node as a whole: puts the parts together and looks after them.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::compat::{self, Face};
use super::diagnostics::{self, Diagnostics, Monitor};
use super::interrupts::Interrupts;
use super::links::Links;
use super::live_params::{Change, ParameterWatch};
use super::log::{Log, ROSOUT};
use super::mailbox::{Event, Mailbox};
use super::master::{MasterLink, Role, resolved};
use super::matcher::{Matcher, Shared};
use super::publishers::Publishers;
use super::services::Services;
use super::shutdown::StopSignal;
use super::subscriptions::subscribe;
use super::transform_output::TransformOutput;
use super::{params, shell};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::contract::Contract;
use crate::app::App;
use crate::config::Config;

const NAME: &str = "scan_matcher";
/// How often the node looks whether it is to stop.
const TICK: Duration = Duration::from_millis(100);

/// Runs the node `scan_matcher` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    shell::run(NAME, |ros, master, stop| {
        let config = params::read(master, ros.name())?;
        Node::start(ros, master, &config, &Face::native(&config))?.supervise(stop);
        Ok(())
    })
}

/// The same with the parameters and the topics of `laser_scan_matcher`, in whose place it can be put.
pub fn run_as_laser_scan_matcher() -> Result<(), NodeError> {
    shell::run(NAME, |ros, master, stop| {
        let (config, face) = compat::read(master, ros.name())?;
        Node::start(ros, master, &config, &face)?.supervise(stop);
        Ok(())
    })
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
    log: Log,
    parameters: ParameterWatch<'a>,
    transform: Arc<TransformOutput>,
    // Dropping it ends them.
    _services: Services,
}

impl<'a> Node<'a> {
    fn start(ros: &'a Ros, master: &'a Master, config: &Config, face: &Face) -> Result<Self, NodeError> {
        let log = Log::new(ros)?;
        if !face.ignored.is_empty() {
            log.warn(&format!("these parameters mean nothing here and are ignored: {}", face.ignored.join(", ")));
        }
        let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
        let (mailbox, monitor) = (Arc::new(Mailbox::default()), Arc::new(Monitor::default()));
        let interrupts = Arc::new(Interrupts::new(config.contract.shared_memory.as_deref())?);
        let mut app = App::new(config, Arc::clone(&clock))?;
        app.warm_up()?;
        app.set_interrupt(Arc::clone(&interrupts) as Arc<_>);
        let transform = Arc::new(TransformOutput::default());
        transform.switch(ros, config.frames.publish_tf)?;
        let publishers = Publishers::new(ros, Arc::clone(&transform), face)?;
        let diagnostics = Diagnostics::new(ros)?;
        let mut roles = publishers.roles();
        roles.extend(face.inputs.iter().map(|input| input.topic().role()));
        roles.extend([diagnostics.role(), Role::Publisher { topic: ROSOUT, message_type: "rosgraph_msgs/Log".into() }]);
        let contract = app.contract();

        let (mut services, replies) = Services::new(&mailbox);
        let shared = Shared {
            mailbox: Arc::clone(&mailbox),
            interrupts: Arc::clone(&interrupts),
            clock: Arc::clone(&clock),
            monitor: Arc::clone(&monitor),
            replies,
            log: log.clone(),
        };
        let matcher = Matcher::new(app, publishers, shared);
        let matching = thread::Builder::new()
            .name("matching".into())
            .spawn(|| matcher.run())
            .map_err(|problem| NodeError::System { action: "start a thread", problem })?;
        let links = Links::new(ros, &clock, &log)?;
        face.inputs.iter().try_for_each(|&input| subscribe(&links, input, &mailbox, &interrupts))?;
        services.offer(ros)?;
        roles.extend(services.roles(ros)?);
        let parameters = ParameterWatch::new(master, ros.name(), config)?;
        let master = MasterLink::new(ros, master, roles, &log)?;
        announce(ros, &log, config, &contract)?;
        Ok(Self {
            ros,
            clock,
            mailbox,
            monitor,
            diagnostics,
            master,
            matching,
            links,
            log,
            parameters,
            transform,
            _services: services,
        })
    }

    /// Once a second: the master and the diagnostics. Until somebody wants the node to stop.
    fn supervise(mut self, stop: &StopSignal) {
        let mut last = self.clock.now();
        while !stop.wait(TICK) && self.ros.is_ok() {
            let elapsed = self.clock.now().saturating_sub(last);
            if elapsed >= diagnostics::PERIOD {
                last = self.clock.now();
                self.master.check();
                if self.master.is_present() {
                    self.look_after_parameters();
                }
                self.monitor.set_too_long(self.links.refused());
                let (dropped, present) = (self.mailbox.dropped(), self.master.is_present());
                self.diagnostics.publish(self.ros, &self.monitor, dropped, present, elapsed.as_secs_f64());
            }
        }
        self.mailbox.close();
        let _ = self.matching.join(); // a panic there has been reported by now
    }

    fn look_after_parameters(&mut self) {
        for (name, change) in self.parameters.look() {
            let done = change.and_then(|change| self.apply(change));
            match done {
                Ok(()) => self.log.info(&format!("parameter {name}: in force from now on")),
                Err(problem) => self.log.error(&format!("parameter {name}: no effect: {problem}")),
            }
        }
    }

    fn apply(&mut self, change: Change) -> Result<(), String> {
        match change {
            Change::Matching(change) => self.mailbox.put_event(Event::Change(change)),
            Change::PublishTransform(on) => {
                self.transform.switch(self.ros, on).map_err(|error| error.to_string())?;
                self.transform.role().into_iter().for_each(|role| self.master.add(role));
            }
        }
        Ok(())
    }
}

/// Says that the node is ready, and what for.
fn announce(ros: &Ros, log: &Log, config: &Config, contract: &Contract) -> Result<(), NodeError> {
    let [scan, odometry, pose] =
        [if config.cloud.input { "cloud" } else { "scan" }, "odom", "scan_match_location"].map(|topic| resolved(ros, topic));
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
