//! Outputs of the map.

use std::sync::{Arc, Mutex, PoisonError};

use rosrust::api::Ros;

use super::convert;
use crate::app::map_message;
use crate::map::grid::OccupancyGrid;
use crate::mapping::Mapper;
use crate::messages::nav_msgs;
use crate::messages::visualization_msgs::Marker;
use crate::ros::NodeError;
use crate::ros::output::Output;
use crate::ros::services::LastMap;
use crate::time::Stamp;

/// Every topic of the map.
pub(super) struct Publishers {
    map: Output<nav_msgs::OccupancyGrid>,
    metadata: Output<nav_msgs::MapMetaData>,
    graph: Output<Marker>,
    frame: String,
    /// The map published last, for the service.
    last: LastMap,
}

impl Publishers {
    pub(super) fn new(ros: &Ros, map_frame: &str) -> Result<Self, NodeError> {
        Ok(Self {
            map: Output::latched(ros, "map")?,
            metadata: Output::latched(ros, "map_metadata")?,
            graph: Output::new(ros, "mapper/graph")?,
            frame: map_frame.into(),
            last: Arc::new(Mutex::new(None)),
        })
    }

    /// The map that was published last.
    pub(super) fn last_map(&self) -> LastMap {
        Arc::clone(&self.last)
    }

    /// The map as it was at a time.
    pub(super) fn publish_map(&self, grid: &OccupancyGrid, stamp: Stamp) {
        let mut message = map_message::message(grid, &self.frame);
        (message.header.stamp, message.info.map_load_time) = (stamp.into(), stamp.into());
        self.metadata.keep(&message.info);
        self.map.keep(&message);
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(message);
    }

    /// The graph, if anybody looks at it.
    pub(super) fn publish_graph(&self, mapper: &Mapper, stamp: Stamp) {
        if self.graph.has_listeners() {
            for marker in convert::markers(mapper, stamp, &self.frame) {
                self.graph.send(|| marker);
            }
        }
    }
}
