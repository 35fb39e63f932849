//! Size of the point clouds of a topic, and how many of them are usable.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::cloud::own_heights;
use crate::messages::sensor_msgs::PointCloud2;

use super::super::BagMessage;
use super::with_cause;

/// Summary of the point clouds on a topic. Numbers of points are those of the last cloud.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CloudSummary {
    /// Name of the topic.
    pub topic: String,
    /// Frames of the clouds: usually one.
    pub frames: BTreeSet<String>,
    /// Number of points in a row.
    pub width: u32,
    /// Number of rows: one, or the number of layers of the sensor.
    pub height: u32,
    /// Minimum height of a point in the frame of its cloud, m.
    pub lowest_m: Option<f64>,
    /// Maximum height of a point in the frame of its cloud, m.
    pub highest_m: Option<f64>,
    /// Number of clouds with readable points.
    pub usable: u64,
    /// Number of clouds without readable points.
    pub unusable: u64,
    /// Why the first unusable cloud has no readable points.
    pub first_error: Option<String>,
}

impl CloudSummary {
    pub(super) fn new(topic: &str) -> Self {
        Self { topic: topic.into(), ..Self::default() }
    }

    pub(super) fn add(&mut self, message: &BagMessage<'_>) {
        let cloud: PointCloud2 = match message.decode() {
            Ok(cloud) => cloud,
            Err(error) => return self.unusable(with_cause(&error)),
        };
        (self.width, self.height) = (cloud.width, cloud.height);
        match own_heights(&cloud) {
            Ok(Some((low, high))) => {
                self.usable += 1;
                self.lowest_m = Some(self.lowest_m.map_or(low, |lowest| lowest.min(low)));
                self.highest_m = Some(self.highest_m.map_or(high, |highest| highest.max(high)));
            }
            Ok(None) => self.unusable("no point has finite coordinates".into()),
            Err(error) => self.unusable(error.to_string()),
        }
        self.frames.insert(cloud.header.frame_id);
    }

    fn unusable(&mut self, error: String) {
        self.unusable += 1;
        self.first_error.get_or_insert(error);
    }

    pub(super) fn problems(&self) -> Vec<String> {
        let Self { topic, usable, unusable, frames, .. } = self;
        let mut problems = Vec::new();
        if let Some(error) = &self.first_error {
            problems.push(format!("{topic}: {unusable} of {} clouds are unusable; the first: {error}", unusable + usable));
        }
        if frames.len() > 1 {
            problems.push(format!("{topic}: clouds are in {} different frames", frames.len()));
        }
        if frames.contains("") {
            problems.push(format!("{topic}: some clouds have no frame_id"));
        }
        problems
    }
}
