//! Loads the true poses to compare with: from a file, or from a topic of the bag.

use std::path::Path;

use thiserror::Error;

use crate::app::{InputError, planar_pose};
use crate::evaluation::trajectory::{StampedPose, Trajectory, TrajectoryError};
use crate::io::bag::{Bag, BagError};
use crate::io::text::TextFileError;
use crate::io::tum;
use crate::messages::geometry_msgs::PoseStamped;
use crate::messages::nav_msgs::Odometry;

/// Why the true poses cannot be loaded.
#[derive(Debug, Error)]
pub enum TruthError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// The bag cannot be read, or the topic has another type.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A message has no valid pose.
    #[error("{topic}: {source}")]
    Pose {
        /// The topic.
        topic: String,
        /// What is wrong.
        source: InputError,
    },
    /// The poses are not a valid trajectory.
    #[error("{topic}: {source}")]
    Trajectory {
        /// The topic.
        topic: String,
        /// What is wrong.
        source: TrajectoryError,
    },
}

/// Loads the true poses from `name`: a topic of the bag (`geometry_msgs/PoseStamped` or `nav_msgs/Odometry`) if it has one of
/// that name, otherwise a file.
pub fn load(name: &str, bag: &Bag) -> Result<Trajectory, TruthError> {
    let is_topic = bag.connections().iter().any(|connection| connection.topic == name);
    if is_topic { from_topic(name, bag) } else { Ok(tum::read(Path::new(name))?) }
}

fn from_topic(topic: &str, bag: &Bag) -> Result<Trajectory, TruthError> {
    let in_odometry = bag.topics_of::<Odometry>().contains(&topic);
    if !in_odometry {
        bag.expect_topic::<PoseStamped>(topic)?;
    }
    let mut poses = Vec::new();
    for message in bag.messages(Some(&[topic])) {
        let message = message?;
        let (header, pose) = if in_odometry {
            let odometry: Odometry = message.decode()?;
            (odometry.header, odometry.pose.pose)
        } else {
            let stamped: PoseStamped = message.decode()?;
            (stamped.header, stamped.pose)
        };
        let pose = planar_pose(&pose).map_err(|source| TruthError::Pose { topic: topic.into(), source })?;
        poses.push(StampedPose { stamp: header.stamp.into(), pose });
    }
    Trajectory::new(poses).map_err(|source| TruthError::Trajectory { topic: topic.into(), source })
}
