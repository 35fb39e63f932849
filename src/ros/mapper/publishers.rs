//! The publishers of the map.

use std::sync::{Arc, Mutex};

use rosrust::api::Ros;

use super::convert;
use crate::app::map_message;
use crate::map::grid::OccupancyGrid;
use crate::mapping::Mapper;
use crate::messages::visualization_msgs::Marker;
use crate::parallel::lock;
use crate::ros::NodeError;
use crate::ros::map_output::MapOutput;
use crate::ros::output::Output;
use crate::ros::services::LastMap;
use crate::time::Stamp;

/// The publishers of all topics of the map.
pub(super) struct Publishers {
    map: MapOutput,
    graph: Output<Marker>,
    frame: String,
    /// The latest published map, for the service.
    last: LastMap,
}

impl Publishers {
    pub(super) fn new(ros: &Ros, map_frame: &str) -> Result<Self, NodeError> {
        Ok(Self {
            map: MapOutput::new(ros)?,
            graph: Output::new(ros, "mapper/graph")?,
            frame: map_frame.into(),
            last: Arc::new(Mutex::new(None)),
        })
    }

    /// The latest published map.
    pub(super) fn last_map(&self) -> LastMap {
        Arc::clone(&self.last)
    }

    /// Publishes the map of the time `stamp`.
    pub(super) fn publish_map(&self, grid: &OccupancyGrid, stamp: Stamp) {
        let mut message = map_message::message(grid, &self.frame);
        (message.header.stamp, message.info.map_load_time) = (stamp.into(), stamp.into());
        self.map.send(&message);
        *lock(&self.last) = Some(message);
    }

    /// Publishes the graph if it is subscribed to.
    pub(super) fn publish_graph(&self, mapper: &Mapper, stamp: Stamp) {
        if self.graph.has_subscribers() {
            for marker in convert::markers(mapper, stamp, &self.frame) {
                self.graph.send(|| marker);
            }
        }
    }
}
