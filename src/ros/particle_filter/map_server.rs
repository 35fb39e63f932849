//! The map of a file, for others who want to see it: as `map_server` publishes and serves it.

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

/// What the map leaves by, for as long as this lives.
pub(super) struct MapServer {
    map: Output<nav_msgs::OccupancyGrid>,
    metadata: Output<nav_msgs::MapMetaData>,
}

impl MapServer {
    /// Publishes and serves `grid`, unless another node publishes a map there already: two would take turns in whoever listens.
    pub(super) fn new(ros: &Ros, config: &Config, log: &Log, grid: &OccupancyGrid) -> Result<Option<(Self, Service)>, NodeError> {
        if let Some(other) = other_publisher(ros)? {
            log.info(&format!("the map is not published: {other} publishes {}", resolved(ros, MAP)?));
            return Ok(None);
        }
        let message = map_message::message(grid, &config.frames.map_frame);
        let server = Self { map: Output::latched(ros, MAP)?, metadata: Output::latched(ros, "map_metadata")? };
        server.metadata.keep(&message.info);
        server.map.keep(&message);
        let answer = services::map_response(&message).map_err(|problem| NodeError::ros("serve the map", &problem))?;
        let service = services::static_map(ros, STATIC_MAP, answer)?;
        log.info(&format!("publishes it as {} and serves it as {}", resolved(ros, MAP)?, resolved(ros, STATIC_MAP)?));
        Ok(Some((server, service)))
    }
}

/// Another node that publishes the map, if there is one.
fn other_publisher(ros: &Ros) -> Result<Option<String>, NodeError> {
    let (topic, master) = (resolved(ros, MAP)?, connect(ros.name(), ros.uri())?);
    let state = master.get_system_state().map_err(|error| NodeError::ros("ask who publishes the map", &error))?;
    let entry = rosrust::api::SystemState::from(state).publishers.into_iter().find(|entry| entry.name == topic);
    Ok(entry.and_then(|entry| entry.connections.into_iter().find(|node| node != ros.name())))
}
