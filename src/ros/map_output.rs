//! Publishes a map as `map_server` does.

use rosrust::api::Ros;

use super::NodeError;
use super::output::Output;
use crate::messages::nav_msgs::{MapMetaData, OccupancyGrid};

/// The latched publishers of a map and of its metadata. Dropping this ends them.
pub(super) struct MapOutput {
    map: Output<OccupancyGrid>,
    metadata: Output<MapMetaData>,
}

impl MapOutput {
    /// Topic of the map.
    pub(super) const TOPIC: &str = "map";

    pub(super) fn new(ros: &Ros) -> Result<Self, NodeError> {
        Ok(Self { map: Output::latched(ros, Self::TOPIC)?, metadata: Output::latched(ros, "map_metadata")? })
    }

    pub(super) fn send(&self, map: &OccupancyGrid) {
        self.metadata.send_always(&map.info);
        self.map.send_always(map);
    }
}
