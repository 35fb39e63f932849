//! The particle filter node: localization on a map.
//!
//! ```text
//!  reader threads               localizing thread             main thread
//!  subscriptions --> mailbox --> worker --> publishers        node
//!                     timer -----^
//! ```

mod convert;
mod filter_node;
mod map_server;
mod publishers;

use std::path::Path;

use rosrust::api::{Master, Ros};

use self::filter_node::FilterNode;
use self::publishers::Publishers;
use super::diagnostics::TaskWording;
use super::input::scan_topic;
use super::log::Log;
use super::master::resolved;
use super::node::{self, Node, NodeParts};
use super::shutdown::StopSignal;
use super::{NodeError, params, services};
use crate::anytime::contract::Contract;
use crate::config::Config;
use crate::io::map_file;
use crate::map::grid::OccupancyGrid;

const NAME: &str = "particle_filter";
/// The service that starts global localization, and its reply.
const GLOBAL: (&str, &str) = ("~global_localization", "global localization: the robot may be anywhere on the map");
const TASK: TaskWording = TaskWording { title: "localization", doing: "localizing", done: "used" };

/// Runs the node `particle_filter` until SIGINT, SIGTERM or the master ends it. The process arguments are those of ROS:
/// remappings and private parameters.
pub fn run() -> Result<(), NodeError> {
    node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let config = params::read(master, ros.name())?;
    let parts = NodeParts::new(ros, master)?;
    let log = parts.shared.log.clone();
    let node = build(ros, parts, &config)?;
    announce(ros, &log, &config)?;
    node.run(stop, || ())
}

fn build<'a>(ros: &Ros, mut parts: NodeParts<'a>, config: &Config) -> Result<Node<'a>, NodeError> {
    let log = &parts.shared.log;
    let map = read_map_file(config, log);
    let served = map.as_ref().map(|map| map_server::serve(ros, config, log, map)).transpose()?.flatten();
    let (map_output, static_map) = served.unzip();
    let publishers = Publishers::new(ros, &config.frames, map_output)?;
    parts.diagnose(TASK)?;
    parts.services = [services::reset(ros, GLOBAL, &parts.shared.mailbox)?].into_iter().chain(static_map).collect();
    let timer = config.localization.timer(parts.shared.clock.now());
    let node = FilterNode::new(config.clone(), publishers, map);
    parts.build("localizing", node, FilterNode::inputs(config.cloud.input), timer)
}

/// Reads the map file that the configuration names. An error is only logged, since a map may still arrive on the topic.
fn read_map_file(config: &Config, log: &Log) -> Option<OccupancyGrid> {
    let path = config.localization.map.as_deref()?;
    let map = map_file::read(Path::new(path));
    map.inspect_err(|error| log.error(&format!("{error}; waiting for a map on the topic map"))).ok()
}

/// Logs that the node is ready, with its topics, frames and contract.
fn announce(ros: &Ros, log: &Log, config: &Config) -> Result<(), NodeError> {
    let contract = Contract::try_from(&config.contract)?;
    let topic = |name| resolved(ros, name);
    let (frames, knobs) = (&config.frames, &config.localization);
    let period = knobs.update_period.0;
    log.info(&format!(
        "localizing with {} and {}; poses on {} ({} -> {}{}); {} particles, {}; contract: {}",
        topic(scan_topic(config.cloud.input))?,
        topic("odom")?,
        topic(publishers::POSE)?,
        frames.map_frame,
        frames.base_frame,
        if frames.publish_tf { format!(", also {} -> {} on /tf", frames.map_frame, frames.odom_frame) } else { String::new() },
        knobs.particles,
        if period > 0.0 { format!("updated every {period} s") } else { "updated with every scan".into() },
        contract,
    ));
    Ok(())
}
