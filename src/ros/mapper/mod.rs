//! Mapping beside the scan matcher: keyframes, loop closures, the occupancy grid, and the pose of the odometry frame on the map.
//!
//! ```text
//!  reader threads               matching thread                     mapping thread                main thread
//!  subscriptions --> mailbox --> matcher --> its publishers          keyframes, loops, grid       supervisor
//!                                  |  feed: scans, a bounded channel --> maker --> map, graph, files
//!                                  ^------ pose of the odometry frame on the map -----v
//! ```
//!
//! The pose graph gives the pose of the odometry frame on the map; the matcher itself closes no loops here. Its answers never
//! wait for the map.

mod convert;
mod feed;
mod maker;
mod publishers;

use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use rosrust::api::Ros;

use self::feed::MapCommand;
pub(super) use self::feed::MapFeed;
use self::maker::MapMaker;
use self::publishers::Publishers;
use super::context::Shared;
use super::services::{self, Service};
use super::threads::spawn;
use super::{NodeError, params};
use crate::config::Config;
use crate::geometry::Pose2;

/// Maximum number of scans that wait for the mapping thread: some seconds of a fast laser, while a long loop is closed.
const CAPACITY: usize = 256;
/// Maximum number of keyframes that the matcher keeps: more than it matches against, as it closes no loops.
const MAX_MATCHER_KEYFRAMES: u32 = 100;

/// Configures the matcher for mapping: the map closes the loops.
pub(super) fn prepare(node: &str, config: &mut Config) -> Result<(), NodeError> {
    check_name(node, &config.mapping.name)?;
    config.odometry.close_loops = false;
    config.odometry.max_keyframes = config.odometry.max_keyframes.min(MAX_MATCHER_KEYFRAMES);
    Ok(())
}

/// Checks that the name of the map leads to no other folder.
fn check_name(node: &str, name: &str) -> Result<(), NodeError> {
    if name.is_empty() || name.starts_with('.') || name.contains(['/', '\0']) {
        let problem = format!("expected a name without slashes, such as 'map', got '{name}'; mapping.directory is the folder");
        return Err(params::bad_value(node, "mapping.name", problem));
    }
    Ok(())
}

/// The mapping beside a scan matcher.
pub(super) struct Mapping {
    commands: SyncSender<MapCommand>,
    thread: JoinHandle<()>,
    pub(super) services: Vec<Service>,
    /// The matching thread's end of the exchange.
    pub(super) feed: Option<MapFeed>,
}

impl Mapping {
    pub(super) fn start(ros: &Ros, config: &Config, shared: &Shared) -> Result<Self, NodeError> {
        let (commands, received) = sync_channel(CAPACITY);
        let map_from_odom = Arc::new(Mutex::new((0, Pose2::IDENTITY)));
        let publishers = Publishers::new(ros, &config.frames.map_frame)?;
        let services = vec![
            services::map(ros, "dynamic_map", publishers.last_map())?,
            services::delegated(ros, "~save_map", commands.clone(), MapCommand::Save)?,
        ];
        let feed = MapFeed::new(commands.clone(), Arc::clone(&map_from_odom), Arc::clone(&shared.monitor));
        let (config, clock, log) = (config.clone(), Arc::clone(&shared.clock), shared.log.clone());
        let thread = spawn("mapping", move || MapMaker::new(config, clock, log, publishers, map_from_odom).run(&received))?;
        Ok(Self { commands, thread, services, feed: Some(feed) })
    }

    /// Ends the mapping thread, after the matcher has ended, and waits until the map is saved if `save_on_exit` is set.
    pub(super) fn end(self) {
        let _ = self.commands.send(MapCommand::End); // fails only if the thread has panicked, which has already been printed
        let _ = self.thread.join();
    }
}
