//! The particle filter as a node: where the robot is on a map.
//!
//! ```text
//!  reader threads               localizing thread             main thread
//!  subscriptions --> mailbox --> worker --> publishers        supervisor
//!                     timer -----^
//! ```

mod convert;
mod filter_node;
mod input;
mod map_server;
mod publishers;

use std::path::Path;
use std::sync::Arc;

use rosrust::api::{Master, Ros};

use self::filter_node::FilterNode;
use self::input::Input;
use self::map_server::MapServer;
use self::publishers::Publishers;
use super::diagnostics::{Diagnostics, Monitor, Task};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::Mailbox;
use super::master::resolved;
use super::node::describe;
use super::shutdown::StopSignal;
use super::subscriptions::Subscriptions;
use super::supervisor::{self, Parts, Supervisor};
use super::worker::{NodeInput as _, Shared, Worker, subscribe};
use super::{NodeError, params, services, shell};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::contract::Contract;
use crate::config::Config;
use crate::io::map_file;
use crate::map::grid::OccupancyGrid;

const NAME: &str = "particle_filter";
/// The service that begins anew, and what it answers.
const GLOBAL: (&str, &str) = ("~global_localization", "the robot may be anywhere on the map");
const TASK: Task = Task { title: "localization", doing: "localizing", done: "used" };

/// Runs the node `particle_filter` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    shell::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let config = params::read(master, ros.name())?;
    let log = Log::new(ros)?;
    let supervisor = Supervisor::new(ros, master, start(ros, &config, &log)?, &log)?;
    announce(ros, &log, &config)?;
    supervisor.run(stop, |_| ());
    Ok(())
}

fn start<'a>(ros: &'a Ros, config: &Config, log: &Log) -> Result<Parts<'a, Input>, NodeError> {
    let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
    let (mailbox, monitor) = (Arc::new(Mailbox::default()), Arc::new(Monitor::default()));
    let interrupts = Arc::new(Interrupts::new(None)?);
    let map = read_map_file(config, log);
    let map_server = map.as_ref().map(|map| MapServer::new(ros, config, log, map)).transpose()?.flatten();
    let (map_server, static_map) = map_server.unzip();
    let publishers = Publishers::new(ros, &config.frames, map_server)?;
    let diagnostics = Diagnostics::new(ros, TASK)?;
    let mut registrations = publishers.registrations();
    registrations.extend(Input::wanted(config).map(|input| input.topic().registration()));

    let services = [services::reset(ros, GLOBAL, &mailbox)?].into_iter().chain(static_map).collect();
    let subscriptions = Subscriptions::new(ros, &clock, log)?;
    Input::wanted(config).try_for_each(|input| subscribe(&subscriptions, input, &mailbox, &interrupts))?;
    let shared = Shared {
        mailbox: Arc::clone(&mailbox),
        interrupts,
        clock: Arc::clone(&clock),
        monitor: Arc::clone(&monitor),
        log: log.clone(),
        takes_clouds: config.cloud.input,
    };
    let (node, timer) = (FilterNode::new(config.clone(), publishers, map), config.localization.timer(clock.now()));
    let worker = supervisor::spawn("localizing", || Worker::new(node, shared).run(timer))?;
    Ok(Parts { clock, mailbox, monitor, diagnostics, worker, subscriptions, services, registrations })
}

/// The map of the file that the configuration names. An unusable one is logged only: the map may still come on the topic.
fn read_map_file(config: &Config, log: &Log) -> Option<OccupancyGrid> {
    let path = config.localization.map.as_deref()?;
    let map = map_file::read(Path::new(path));
    map.inspect_err(|error| log.error(&format!("{error}; waiting for a map on the topic map"))).ok()
}

/// Says that the node is ready, and what for.
fn announce(ros: &Ros, log: &Log, config: &Config) -> Result<(), NodeError> {
    let contract = Contract::try_from(&config.contract)?;
    let [scan, odometry, pose] =
        [if config.cloud.input { "cloud" } else { "scan" }, "odom", publishers::POSE].map(|topic| resolved(ros, topic));
    let (frames, knobs) = (&config.frames, &config.localization);
    let period = knobs.update_period.0;
    log.info(&format!(
        "localizes by {} and {} to {} ({} -> {}{}), {} particles, {}, {}",
        scan?,
        odometry?,
        pose?,
        frames.map_frame,
        frames.base_frame,
        if frames.publish_tf { format!(", also {} -> {} on /tf", frames.map_frame, frames.odom_frame) } else { String::new() },
        knobs.particles,
        if period > 0.0 { format!("every {period} s") } else { "with every scan".into() },
        describe(&contract),
    ));
    Ok(())
}
