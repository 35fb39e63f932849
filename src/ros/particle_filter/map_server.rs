//! Publishes and serves the map from a file for other nodes, as `map_server` does.

use rosrust::api::Ros;

use crate::app::map_message;
use crate::config::Config;
use crate::map::grid::OccupancyGrid;
use crate::ros::NodeError;
use crate::ros::log::Log;
use crate::ros::map_output::MapOutput;
use crate::ros::master::{connect, resolved};
use crate::ros::services::{self, Service};

const SERVICE: &str = "static_map";

/// Publishes and serves `grid`, unless another node already publishes a map: subscribers would receive both in turn.
pub(super) fn serve(
    ros: &Ros,
    config: &Config,
    log: &Log,
    grid: &OccupancyGrid,
) -> Result<Option<(MapOutput, Service)>, NodeError> {
    let topic = resolved(ros, MapOutput::TOPIC)?;
    if let Some(other) = other_publisher(ros, &topic)? {
        log.info(&format!("not publishing the map: {other} already publishes {topic}"));
        return Ok(None);
    }
    let message = map_message::message(grid, &config.frames.map_frame);
    let output = MapOutput::new(ros)?;
    output.send(&message);
    let answer = services::map_response(&message).map_err(|problem| NodeError::ros("serve the map", &problem))?;
    let service = services::static_map(ros, SERVICE, answer)?;
    log.info(&format!("publishing the map on {topic} and serving it by {}", resolved(ros, SERVICE)?));
    Ok(Some((output, service)))
}

/// Another node that publishes `topic`, if there is one.
fn other_publisher(ros: &Ros, topic: &str) -> Result<Option<String>, NodeError> {
    let master = connect(ros.name(), ros.uri())?;
    let state =
        master.get_system_state().map_err(|error| NodeError::ros("get the publishers of the map from the master", &error))?;
    let entry = rosrust::api::SystemState::from(state).publishers.into_iter().find(|entry| entry.name == topic);
    Ok(entry.and_then(|entry| entry.connections.into_iter().find(|node| node != ros.name())))
}
