//! Writes a simulated drive to a bag and its true poses to a TUM file; finds the cells of the true map that the rays of such a
//! bag hit.

use std::collections::BTreeMap;
use std::io::Write;

use thiserror::Error;

use crate::evaluation::trajectory::StampedPose;
use crate::geometry::Pose2;
use crate::map::grid::OccupancyGrid;
use crate::messages::geometry_msgs::{Point, PoseStamped, Transform, TransformStamped, Vector3};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::scan::BeamGeometry;
use crate::simulation::drive::{Settings, SimulatedMessage, simulate, truth_message};
use crate::simulation::lidar::LASER_FRAME;
use crate::simulation::odometer::BASE_FRAME;
use crate::simulation::scene::Scene;
use crate::time::Stamp;
use crate::transforms::TransformTree;

use super::bag::{Bag, BagError, BagWriter};
use super::tum::TumWriter;

/// Why a drive could not be written.
#[derive(Debug, Error)]
pub enum DriveRecordError {
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The true poses cannot be written.
    #[error("cannot write the true poses: {0}")]
    Truth(std::io::Error),
}

/// Topic of the true poses.
pub const TRUTH_TOPIC: &str = "/gt_pose";
/// Topic of the scans.
const SCAN_TOPIC: &str = "/scan";
/// Topic of the laser's mount.
const MOUNT_TOPIC: &str = "/tf_static";

/// Why the cells hit by the rays of a drive cannot be determined.
#[derive(Debug, Error)]
pub enum CellsHitError {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The bag has no true poses for its scans.
    #[error(
        "{path}: no scan on {SCAN_TOPIC} has a true pose with the same stamp on {TRUTH_TOPIC}: \
         give a bag written by `anytime simulate`"
    )]
    NoTruth {
        /// The file.
        path: String,
    },
    /// The bag has no transform from the base to the laser.
    #[error(
        "{path}: {MOUNT_TOPIC} has no transform from {BASE_FRAME} to {LASER_FRAME}: give a bag written by `anytime simulate`"
    )]
    NoMount {
        /// The file.
        path: String,
    },
}

/// Which cells of the true map `world` the rays of a simulated drive hit, by cell number. Rays are cast from the true poses of
/// the laser, so that neither noise nor moving people matter. All rays of a scan are cast from the pose at its stamp.
pub fn cells_hit(bag: &Bag, world: &OccupancyGrid) -> Result<Vec<bool>, CellsHitError> {
    let path = || bag.path().display().to_string();
    [
        bag.expect_topic::<PoseStamped>(TRUTH_TOPIC),
        bag.expect_topic::<LaserScan>(SCAN_TOPIC),
        bag.expect_topic::<TFMessage>(MOUNT_TOPIC),
    ]
    .into_iter()
    .collect::<Result<(), _>>()?;
    let (mut poses, mut scans, mut frames) = (BTreeMap::new(), BTreeMap::new(), TransformTree::default());
    for message in bag.messages(Some(&[TRUTH_TOPIC, SCAN_TOPIC, MOUNT_TOPIC])) {
        let message = message?;
        match message.connection.topic.as_str() {
            TRUTH_TOPIC => {
                let PoseStamped { header, pose } = message.decode()?;
                let map_from_base = Pose2::new(pose.position.x, pose.position.y, pose.orientation.yaw());
                poses.insert(Stamp::from(header.stamp), map_from_base);
            }
            SCAN_TOPIC => {
                let scan: LaserScan = message.decode()?;
                let beams = BeamGeometry::new(scan.angle_min.into(), scan.angle_increment.into(), scan.ranges.len());
                scans.insert(Stamp::from(scan.header.stamp), (beams, f64::from(scan.range_max)));
            }
            _ => _ = frames.add(&message.decode()?),
        }
    }
    let mount = frames.mount(BASE_FRAME, LASER_FRAME).ok_or_else(|| CellsHitError::NoMount { path: path() })?;
    let views = scans.iter().filter_map(|(stamp, view)| Some((*poses.get(stamp)? * mount.base_from_laser, view)));
    let (mut hit, mut is_empty) = (vec![false; world.cells().len()], true);
    for (map_from_laser, (beams, range_max)) in views {
        mark_cells_hit(world, &map_from_laser, beams, *range_max, &mut hit);
        is_empty = false;
    }
    if is_empty { Err(CellsHitError::NoTruth { path: path() }) } else { Ok(hit) }
}

/// Marks the cells that the rays of a scan hit.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // columns and rows of the map
fn mark_cells_hit(world: &OccupancyGrid, map_from_laser: &Pose2, beams: &BeamGeometry, range_max: f64, hit: &mut [bool]) {
    // A ray ends on the edge of the cell that it hits: a point slightly further on is inside.
    let margin = 1e-6 * world.resolution();
    let (laser, transform) = (map_from_laser.translation(), map_from_laser.transform());
    for direction in beams.directions().iter().map(|&direction| transform.rotate(direction)) {
        if let Some(range) = world.range(laser, direction, range_max) {
            let end = world.coordinates(laser + direction * (range + margin));
            if let Some(cell) = hit.get_mut(end.y as usize * world.width() + end.x as usize) {
                *cell = true;
            }
        }
    }
}

/// The transform from the odometry frame to the base, as drivers publish it along with odometry.
fn odometry_transform(odometry: &Odometry) -> TFMessage {
    let Point { x, y, z } = odometry.pose.pose.position;
    let transform = Transform { translation: Vector3 { x, y, z }, rotation: odometry.pose.pose.orientation.clone() };
    let (header, child_frame_id) = (odometry.header.clone(), odometry.child_frame_id.clone());
    TFMessage { transforms: vec![TransformStamped { header, child_frame_id, transform }] }
}

/// Simulates a drive. Writes its messages to `bag` and the true pose of every scan to `truth`. Returns the number of scans.
pub fn record<W: Write>(
    settings: &Settings,
    scene: &Scene,
    mut bag: BagWriter,
    mut truth: TumWriter<W>,
) -> Result<u64, DriveRecordError> {
    let mut scans = 0;
    simulate(settings, scene, |time, message| -> Result<(), DriveRecordError> {
        match message {
            SimulatedMessage::Mount(message) => bag.write_latched(MOUNT_TOPIC, time, &message)?,
            SimulatedMessage::Odometry(message) => {
                bag.write("/tf", time, &odometry_transform(&message))?;
                bag.write("/odom", time, &message)?;
            }
            SimulatedMessage::Truth { stamp, map_from_base } => {
                truth.write(&StampedPose { stamp, pose: map_from_base }).map_err(DriveRecordError::Truth)?;
                bag.write(TRUTH_TOPIC, time, &truth_message(stamp, map_from_base))?;
            }
            SimulatedMessage::Scan(message) => {
                scans += 1;
                bag.write(SCAN_TOPIC, time, &message)?;
            }
        }
        Ok(())
    })?;
    truth.flush().map_err(DriveRecordError::Truth)?;
    bag.finish()?;
    Ok(scans)
}
