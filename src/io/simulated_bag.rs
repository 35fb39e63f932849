//! A simulated drive as a bag, and its truth as a TUM file.

use std::io::Write;

use thiserror::Error;

use crate::evaluation::trajectory::StampedPose;
use crate::simulation::drive::{Settings, SimulatedMessage, simulate, truth_message};
use crate::simulation::scene::Scene;

use super::bag::{BagError, BagWriter};
use super::tum::TumWriter;

/// Why a drive was not written to its end.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The truth cannot be written.
    #[error("cannot write the true poses: {0}")]
    Truth(std::io::Error),
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
            SimulatedMessage::Odometry(message) => bag.write("/odom", time, &message)?,
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
