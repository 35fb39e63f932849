//! Size of the point clouds of a topic, and how many of them are usable.

use serde::Serialize;

use crate::cloud::own_heights;
use crate::messages::sensor_msgs::PointCloud2;

use super::super::BagMessage;
use super::{Usability, with_cause};

/// Summary of the point clouds on a topic. Numbers of points are those of the last cloud.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CloudSummary {
    /// Name of the topic.
    pub topic: String,
    /// Number of points in a row.
    pub width: u32,
    /// Number of rows: one, or the number of layers of the sensor.
    pub height: u32,
    /// Minimum height of a point in the frame of its cloud, m.
    pub lowest_m: Option<f64>,
    /// Maximum height of a point in the frame of its cloud, m.
    pub highest_m: Option<f64>,
    /// Which clouds have readable points.
    #[serde(flatten)]
    pub usability: Usability,
}

impl CloudSummary {
    pub(super) fn new(topic: &str) -> Self {
        Self { topic: topic.into(), ..Self::default() }
    }

    pub(super) fn add(&mut self, message: &BagMessage<'_>) {
        let cloud: PointCloud2 = match message.decode() {
            Ok(cloud) => cloud,
            Err(error) => return self.usability.reject(with_cause(&error)),
        };
        (self.width, self.height) = (cloud.width, cloud.height);
        match own_heights(&cloud) {
            Ok(Some((low, high))) => {
                self.usability.usable += 1;
                self.lowest_m = Some(self.lowest_m.map_or(low, |lowest| lowest.min(low)));
                self.highest_m = Some(self.highest_m.map_or(high, |highest| highest.max(high)));
            }
            Ok(None) => self.usability.reject("no point has finite coordinates".into()),
            Err(error) => self.usability.reject(error.to_string()),
        }
        self.usability.frames.insert(cloud.header.frame_id);
    }

    pub(super) fn problems(&self) -> Vec<String> {
        self.usability.problems(&self.topic, "clouds")
    }
}
