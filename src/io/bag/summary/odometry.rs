//! Frames of the odometry on a topic, and its invalid messages.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::io::tum::NORM_TOLERANCE;
use crate::messages::geometry_msgs::Pose;
use crate::messages::nav_msgs::Odometry;

use super::super::BagMessage;
use super::with_cause;

/// Summary of the odometry on a topic.
#[derive(Clone, Debug, Default, Serialize)]
pub struct OdometrySummary {
    /// Name of the topic.
    pub topic: String,
    /// Frames of the poses (`frame_id`): usually one.
    pub frames: BTreeSet<String>,
    /// Child frames of the poses (`child_frame_id`): usually one.
    pub child_frames: BTreeSet<String>,
    /// Number of poses that are NaN or infinite.
    pub not_finite: u64,
    /// Number of finite poses whose quaternion is not of unit length.
    pub not_normalised: u64,
    /// Number of messages that could not be decoded.
    pub undecodable: u64,
    /// Why the first of these could not be decoded.
    pub first_error: Option<String>,
}

impl OdometrySummary {
    pub(super) fn new(topic: &str) -> Self {
        Self { topic: topic.into(), ..Self::default() }
    }

    pub(super) fn add(&mut self, message: &BagMessage<'_>) {
        match message.decode::<Odometry>() {
            Ok(odometry) => self.add_odometry(odometry),
            Err(error) => {
                self.undecodable += 1;
                self.first_error.get_or_insert_with(|| with_cause(&error));
            }
        }
    }

    fn add_odometry(&mut self, odometry: Odometry) {
        let Pose { position: p, orientation } = odometry.pose.pose;
        let norm = orientation.norm();
        if ![p.x, p.y, p.z, norm].iter().all(|number| number.is_finite()) {
            self.not_finite += 1;
        } else if (norm - 1.0).abs() > NORM_TOLERANCE {
            self.not_normalised += 1;
        }
        self.frames.insert(odometry.header.frame_id);
        self.child_frames.insert(odometry.child_frame_id);
    }

    pub(super) fn problems(&self) -> Vec<String> {
        let topic = &self.topic;
        let mut problems = Vec::new();
        if self.not_finite > 0 {
            problems.push(format!("{topic}: {} poses are NaN or infinite", self.not_finite));
        }
        if self.not_normalised > 0 {
            problems.push(format!("{topic}: {} quaternions are not of unit length", self.not_normalised));
        }
        if let Some(error) = &self.first_error {
            problems.push(format!("{topic}: {} messages cannot be decoded; the first: {error}", self.undecodable));
        }
        if self.frames.len() > 1 || self.child_frames.len() > 1 {
            problems.push(format!("{topic}: the frames change within the bag"));
        }
        problems
    }
}
