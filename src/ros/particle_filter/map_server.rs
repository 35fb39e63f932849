//! Publishes and serves the map from a file for other nodes, as `map_server` does.

use rosrust::api::Ros;

use crate::app::map_message;
use crate::config::Config;
use crate::map::grid::OccupancyGrid;
use crate::messages::nav_msgs;
use crate::ros::NodeError;
use crate::ros::log::Log;
use crate::ros::master::{connect, resolved};
use crate::ros::output::Output;
use crate::ros::services::{self, Service};

const MAP: &str = "map";
const STATIC_MAP: &str = "static_map";

/// The publishers of the map. Dropping this ends them.
pub(super) struct MapServer {
    map: Output<nav_msgs::OccupancyGrid>,
    metadata: Output<nav_msgs::MapMetaData>,
}

impl MapServer {
    /// Publishes and serves `grid`, unless another node already publishes a map: subscribers would receive both in turn.
    pub(super) fn new(ros: &Ros, config: &Config, log: &Log, grid: &OccupancyGrid) -> Result<Option<(Self, Service)>, NodeError> {
        if let Some(other) = other_publisher(ros)? {
            log.info(&format!("not publishing the map: {other} already publishes {}", resolved(ros, MAP)?));
            return Ok(None);
        }
        let message = map_message::message(grid, &config.frames.map_frame);
        let server = Self { map: Output::latched(ros, MAP)?, metadata: Output::latched(ros, "map_metadata")? };
        server.metadata.send_always(&message.info);
        server.map.send_always(&message);
        let answer = services::map_response(&message).map_err(|problem| NodeError::ros("serve the map", &problem))?;
        let service = services::static_map(ros, STATIC_MAP, answer)?;
        log.info(&format!("publishing the map on {} and serving it by {}", resolved(ros, MAP)?, resolved(ros, STATIC_MAP)?));
        Ok(Some((server, service)))
    }
}

/// Another node that publishes the map, if there is one.
fn other_publisher(ros: &Ros) -> Result<Option<String>, NodeError> {
    let (topic, master) = (resolved(ros, MAP)?, connect(ros.name(), ros.uri())?);
    let state =
        master.get_system_state().map_err(|error| NodeError::ros("get the publishers of the map from the master", &error))?;
    let entry = rosrust::api::SystemState::from(state).publishers.into_iter().find(|entry| entry.name == topic);
    Ok(entry.and_then(|entry| entry.connections.into_iter().find(|node| node != ros.name())))
}
