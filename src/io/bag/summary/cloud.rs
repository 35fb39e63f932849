//! Points and usability of the clouds of a topic.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::cloud::own_heights;
use crate::messages::sensor_msgs::PointCloud2;

use super::super::BagMessage;
use super::with_cause;

/// The point clouds of a topic. Numbers of points are those of the last cloud.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CloudSummary {
    /// Name of the topic.
    pub topic: String,
    /// Frames that the points are in: one, as a rule.
    pub frames: BTreeSet<String>,
    /// Points of a row.
    pub width: u32,
    /// Rows: one, or the layers of the sensor.
    pub height: u32,
    /// Least height of a point in its own frame.
    pub lowest_m: Option<f64>,
    /// Greatest height of a point in its own frame.
    pub highest_m: Option<f64>,
    /// Clouds with points that can be read.
    pub usable: u64,
    /// Clouds without.
    pub unusable: u64,
    /// What is wrong with the first that has none.
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
            problems.push(format!("{topic}: {unusable} of {} clouds unusable, the first: {error}", unusable + usable));
        }
        if frames.len() > 1 {
            problems.push(format!("{topic}: clouds are in {} different frames", frames.len()));
        }
        if frames.contains("") {
            problems.push(format!("{topic}: clouds without a frame_id"));
        }
        problems
    }
}
