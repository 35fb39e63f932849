//! The scan matcher with a map: what it has seen so far, and where the odometry's frame is on it.
//!
//! ```text
//!  reader threads               matching thread                     mapping thread                main thread
//!  subscriptions --> mailbox --> matcher --> its publishers          keyframes, loops, grid       supervisor
//!                                  |  feed: scans, a bounded channel --> maker --> map, graph, files
//!                                  ^------ where the odometry's frame is on the map --v
//! ```
//!
//! The graph of keyframes says where the odometry's frame is on the map; the matcher itself closes no loops here. Its answers wait for
//! nothing that the map does.

mod convert;
mod feed;
mod maker;
mod publishers;

use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use rosrust::api::Ros;

pub(super) use self::feed::MapFeed;
use self::feed::Order;
use self::maker::MapMaker;
use self::publishers::Publishers;
use super::context::Shared;
use super::services::{self, Service};
use super::{NodeError, node, params};
use crate::config::Config;
use crate::geometry::Pose2;

/// Scans that may wait for the mapping thread: some seconds of a fast laser's, while a great loop is closed.
const CAPACITY: usize = 256;
/// Keyframes of the matcher's own: more than it matches to, as it closes no loops.
const OWN_KEYFRAMES: u32 = 100;

/// What the matcher beside a map is configured as: the map closes the loops.
pub(super) fn prepare(node: &str, config: &mut Config) -> Result<(), NodeError> {
    check_name(node, &config.mapping.name)?;
    config.odometry.close_loops = false;
    config.odometry.max_keyframes = config.odometry.max_keyframes.min(OWN_KEYFRAMES);
    Ok(())
}

/// A name leads to no other folder.
fn check_name(node: &str, name: &str) -> Result<(), NodeError> {
    if name.is_empty() || name.starts_with('.') || name.contains(['/', '\0']) {
        let problem = format!("it is '{name}': expected a name without slashes, such as 'map'; mapping.directory is the folder");
        return Err(params::refused(node, "mapping.name", problem));
    }
    Ok(())
}

/// The mapping beside a scan matcher.
pub(super) struct Mapping {
    orders: SyncSender<Order>,
    thread: JoinHandle<()>,
    pub(super) services: Vec<Service>,
    /// What the matcher hands its answers to.
    pub(super) feed: Option<MapFeed>,
}

impl Mapping {
    pub(super) fn start(ros: &Ros, config: &Config, shared: &Shared) -> Result<Self, NodeError> {
        let (orders, received) = sync_channel(CAPACITY);
        let place = Arc::new(Mutex::new((0, Pose2::IDENTITY)));
        let publishers = Publishers::new(ros, &config.frames.map_frame)?;
        let services = vec![
            services::map(ros, "dynamic_map", publishers.last_map())?,
            services::ordered(ros, "~save_map", orders.clone(), Order::Save)?,
        ];
        let feed = MapFeed::new(orders.clone(), Arc::clone(&place), Arc::clone(&shared.monitor));
        let (config, clock, log) = (config.clone(), Arc::clone(&shared.clock), shared.log.clone());
        let thread = node::spawn("mapping", move || MapMaker::new(config, clock, log, publishers, place).run(&received))?;
        Ok(Self { orders, thread, services, feed: Some(feed) })
    }

    /// Ends the mapping once the matcher has ended, and waits until the map is saved, if it is to be.
    pub(super) fn end(self) {
        let _ = self.orders.send(Order::End); // a thread that has died is told by its panic
        let _ = self.thread.join();
    }
}
