//! The scan matcher as a whole: puts the parts together.

use std::sync::Arc;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::diagnostics::{Diagnostics, Monitor, Task};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::Mailbox;
use super::master::resolved;
use super::matcher::Matcher;
use super::publishers::Publishers;
use super::shutdown::StopSignal;
use super::subscriptions::{Input, subscribe};
use super::supervisor::{self, Call, Parts, Supervisor};
use super::{params, shell};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::contract::Contract;
use crate::app::App;
use crate::config::Config;

const NAME: &str = "scan_matcher";
const RESET: Call = Call { name: "~reset", answer: "the next scan is the first one, at the initial pose" };
const TASK: Task = Task { title: "scan matching", doing: "matching", done: "matched" };

/// Runs the node `scan_matcher` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    shell::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let config = params::read(master, ros.name())?;
    start(ros, master, &config)?.run(stop);
    Ok(())
}

fn start<'a>(ros: &'a Ros, master: &'a Master, config: &Config) -> Result<Supervisor<'a, Input>, NodeError> {
    let log = Log::new(ros)?;
    let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
    let (mailbox, monitor) = (Arc::new(Mailbox::default()), Arc::new(Monitor::default()));
    let interrupts = Arc::new(Interrupts::new(config.contract.shared_memory.as_deref())?);
    let mut app = App::new(config, Arc::clone(&clock))?;
    app.warm_up()?;
    app.set_interrupt(Arc::clone(&interrupts) as Arc<_>);
    let publishers = Publishers::new(ros, config.frames.publish_tf)?;
    let diagnostics = Diagnostics::new(ros, TASK)?;
    let mut roles = publishers.roles();
    roles.extend(Input::ALL.map(|input| input.topic().role()));
    let contract = app.contract();

    let (in_box, time) = (Arc::clone(&mailbox), Arc::clone(&clock));
    let matcher = Matcher::new(app, publishers, in_box, Arc::clone(&interrupts), time, Arc::clone(&monitor), log.clone());
    let worker = supervisor::spawn("matching", || matcher.run())?;
    let subscribers = Input::ALL.map(|input| subscribe(ros, input, &mailbox, &interrupts, &clock, &log));
    let subscribers = subscribers.into_iter().collect::<Result<_, _>>()?;
    let parts = Parts { clock, mailbox, monitor, diagnostics, worker, log: log.clone(), subscribers, roles };
    let supervisor = Supervisor::new(ros, master, parts, RESET)?;
    announce(ros, &log, config, &contract)?;
    Ok(supervisor)
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

/// A contract in words.
pub(super) fn describe(contract: &Contract) -> String {
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
