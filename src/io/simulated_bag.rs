//! A simulated drive as a bag, and its truth as a TUM file.

use std::io::Write;

use thiserror::Error;

use crate::evaluation::trajectory::StampedPose;
use crate::messages::geometry_msgs::{Point, Transform, TransformStamped, Vector3};
use crate::messages::nav_msgs::Odometry;
use crate::messages::tf2_msgs::TFMessage;
use crate::simulation::drive::{Settings, SimulatedMessage, simulate, truth_message};
use crate::simulation::scene::Scene;

use super::bag::{BagError, BagWriter};
use super::tum::TumWriter;

/// Why a drive could not be written.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The truth cannot be written.
    #[error("cannot write the true poses: {0}")]
    Truth(std::io::Error),
}

/// Odometry as a transform, as drivers publish it: where the base is in the frame of the odometry.
fn transform(odometry: &Odometry) -> TFMessage {
    let Point { x, y, z } = odometry.pose.pose.position;
    let transform = Transform { translation: Vector3 { x, y, z }, rotation: odometry.pose.pose.orientation.clone() };
    let (header, child_frame_id) = (odometry.header.clone(), odometry.child_frame_id.clone());
    TFMessage { transforms: vec![TransformStamped { header, child_frame_id, transform }] }
}

/// Simulates a drive and writes it to `bag`, and the true pose of every scan to `truth`. Returns the number of scans.
pub fn record<W: Write>(
    settings: &Settings,
    scene: &Scene,
    mut bag: BagWriter,
    mut truth: TumWriter<W>,
) -> Result<u64, RecordError> {
    let mut scans = 0;
    simulate(settings, scene, |time, message| -> Result<(), RecordError> {
        match message {
            SimulatedMessage::Mount(message) => bag.write_latched("/tf_static", time, &message)?,
            SimulatedMessage::Odometry(message) => {
                bag.write("/tf", time, &transform(&message))?;
                bag.write("/odom", time, &message)?;
            }
            SimulatedMessage::Truth { stamp, map_from_base } => {
                truth.write(&StampedPose { stamp, pose: map_from_base }).map_err(RecordError::Truth)?;
                bag.write("/gt_pose", time, &truth_message(stamp, map_from_base))?;
            }
            SimulatedMessage::Scan(message) => {
                scans += 1;
                bag.write("/scan", time, &message)?;
            }
        }
        Ok(())
    })?;
    truth.flush().map_err(RecordError::Truth)?;
    bag.finish()?;
    Ok(scans)
}
