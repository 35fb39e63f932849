//! The scan matcher node, with mapping or without.
//!
//! ```text
//!  reader threads               matching thread               main thread
//!  subscriptions --> mailbox --> worker --> publishers        node: signals, the master, diagnostics
//! ```

mod compat;
mod convert;
mod matcher;
mod path;
mod publishers;

use std::sync::Arc;

use rosrust::api::{Master, Ros};

use self::compat::NodeInterface;
use self::matcher::MatcherNode;
use self::publishers::Publishers;
use super::context::Shared;
use super::diagnostics::TaskWording;
use super::input::scan_topic;
use super::interrupts::Interrupts;
use super::live_params::{Change, ParameterWatch};
use super::log::Log;
use super::mailbox::{Event, Mailbox, Request};
use super::mapper::{self, Mapping};
use super::master::resolved;
use super::node::{self, Node, NodeParts};
use super::shutdown::StopSignal;
use super::transform_output::TransformOutput;
use super::{NodeError, params, services};
use crate::anytime::contract::Contract;
use crate::app::App;
use crate::config::{Config, FrameKnobs};

const NAME: &str = "scan_matcher";
/// The service that resets the matcher, and its reply.
const RESET: (&str, &str) = ("~reset", "reset: the next scan starts a new run at the initial pose");
const TASK: TaskWording = TaskWording { title: "scan matching", doing: "matching", done: "matched" };

/// Runs the node `scan_matcher` until SIGINT, SIGTERM or the master ends it. The process arguments are those of ROS: remappings
/// and private parameters.
pub fn run() -> Result<(), NodeError> {
    node::run(NAME, |ros, master, stop| {
        let config = params::read(master, ros.name())?;
        serve(ros, master, stop, &config, &NodeInterface::native(), |_| Ok(None))
    })
}

/// The same with the parameters and topics of `laser_scan_matcher`, as a drop-in replacement for it.
pub fn run_as_laser_scan_matcher() -> Result<(), NodeError> {
    node::run(NAME, |ros, master, stop| {
        let (config, interface) = compat::read(master, ros.name())?;
        serve(ros, master, stop, &config, &interface, |_| Ok(None))
    })
}

/// The same with mapping: the node `mapper`.
pub fn run_mapper() -> Result<(), NodeError> {
    node::run("mapper", |ros, master, stop| {
        let mut config = params::read(master, ros.name())?;
        mapper::prepare(ros.name(), &mut config)?;
        stop.hold(config.mapping.save_on_exit);
        let mapping = |shared: &_| Mapping::start(ros, &config, shared).map(Some);
        let outcome = serve(ros, master, stop, &config, &NodeInterface::native(), mapping);
        stop.hold(false);
        outcome
    })
}

/// Runs the scan matcher. `mapping` starts the mapping thread, if there is one.
fn serve(
    ros: &Ros,
    master: &Master,
    stop: &StopSignal,
    config: &Config,
    interface: &NodeInterface,
    mapping: impl FnOnce(&Shared) -> Result<Option<Mapping>, NodeError>,
) -> Result<(), NodeError> {
    let mut parts = NodeParts::new(ros, master)?;
    let log = parts.shared.log.clone();
    if !interface.ignored.is_empty() {
        log.warn(&format!("these parameters have no effect in this node and are ignored: {}", interface.ignored.join(", ")));
    }
    config.warnings().iter().for_each(|warning| log.warn(warning));
    let transform = Arc::new(TransformOutput::default());
    transform.switch(ros, &config.frames.base_frame, config.frames.publish_tf)?;
    transform.switch(ros, &config.frames.odom_frame, config.frames.publish_map_tf)?;
    parts.shared.interrupts = Arc::new(Interrupts::new(config.contract.shared_memory.as_deref())?);
    let mut mapping = mapping(&parts.shared)?;
    let mut changes = Changes {
        watch: ParameterWatch::new(master, ros.name(), config)?,
        mailbox: Arc::clone(&parts.shared.mailbox),
        transform: Arc::clone(&transform),
        ros,
        log: log.clone(),
    };
    let node = build(ros, parts, config, interface, transform, mapping.as_mut())?;
    announce(ros, &log, config)?;
    let outcome = node.run(stop, || changes.poll());
    if let Some(mapping) = mapping {
        mapping.end();
    }
    outcome
}

fn build<'a>(
    ros: &Ros,
    mut parts: NodeParts<'a>,
    config: &Config,
    interface: &NodeInterface,
    transform: Arc<TransformOutput>,
    mapping: Option<&mut Mapping>,
) -> Result<Node<'a>, NodeError> {
    let mut app = App::new(config, Arc::clone(&parts.shared.clock))?;
    app.warm_up()?;
    app.set_interrupt(Arc::clone(&parts.shared.interrupts) as Arc<_>);
    let publishers = Publishers::new(ros, transform, interface)?;
    parts.diagnose(TASK)?;
    let (save_profile, replies) = services::save_profile(ros, &parts.shared.mailbox)?;
    parts.services = vec![services::reset(ros, RESET, &parts.shared.mailbox)?, save_profile];
    let mut feed = None;
    if let Some(mapping) = mapping {
        parts.services.append(&mut mapping.services);
        feed = mapping.feed.take();
    }
    let inputs = MatcherNode::inputs(config.cloud.input, interface.predictors);
    parts.build("matching", MatcherNode::new(app, publishers, replies, feed), inputs, None)
}

/// Applies parameter changes while the node runs.
struct Changes<'a> {
    watch: ParameterWatch<'a>,
    mailbox: Arc<Mailbox>,
    transform: Arc<TransformOutput>,
    ros: &'a Ros,
    log: Log,
}

impl Changes<'_> {
    fn poll(&mut self) {
        for (name, change) in self.watch.poll() {
            match change.and_then(|change| self.apply(change)) {
                Ok(()) => self.log.info(&format!("parameter {name}: now in effect")),
                Err(problem) => self.log.error(&format!("parameter {name}: change ignored: {problem}")),
            }
        }
    }

    fn apply(&self, change: Change) -> Result<(), String> {
        match change {
            Change::Matching(change) => self.mailbox.put_event(Event::Request(Request::Change(change))),
            Change::PublishTransform { child, on } => {
                self.transform.switch(self.ros, &child, on).map_err(|error| error.to_string())?;
            }
        }
        Ok(())
    }
}

/// Logs that the node is ready, with its topics, frames and contract.
fn announce(ros: &Ros, log: &Log, config: &Config) -> Result<(), NodeError> {
    let contract = Contract::try_from(&config.contract)?;
    let topic = |name| resolved(ros, name);
    let frames = &config.frames;
    log.info(&format!(
        "matching {} with {}; poses on {} ({} -> {}; {}); contract: {}; method: {} + {}",
        topic(scan_topic(config.cloud.input))?,
        topic("odom")?,
        topic(publishers::POSE)?,
        frames.map_frame,
        frames.base_frame,
        transforms(frames),
        contract,
        config.matching.correspondence.name(),
        config.matching.solver.name(),
    ));
    Ok(())
}

/// Describes the transforms that are published on `/tf`.
fn transforms(frames: &FrameKnobs) -> String {
    let [map, odom, base] = [&frames.map_frame, &frames.odom_frame, &frames.base_frame];
    match (frames.publish_map_tf, frames.publish_tf) {
        (true, true) => format!("{map} -> {odom} -> {base} on /tf"),
        (true, false) => format!("{map} -> {odom} on /tf"),
        (false, true) => format!("{odom} -> {base} on /tf"),
        (false, false) => "nothing on /tf".into(),
    }
}
