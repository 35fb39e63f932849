//! A simulated drive as a bag, and its truth as a TUM file; what its rays truly met.

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
pub enum RecordError {
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The truth cannot be written.
    #[error("cannot write the true poses: {0}")]
    Truth(std::io::Error),
}

/// Where a drive has its true poses.
pub const TRUTH: &str = "/gt_pose";
const SCANS: &str = "/scan";
const MOUNT: &str = "/tf_static";

/// Why it cannot be told what the rays of a drive met.
#[derive(Debug, Error)]
pub enum NoTrueViews {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// It is of no simulated drive.
    #[error("{path}: no scan on {SCANS} has a true pose of its stamp on {TRUTH}: a bag of anytime simulate is needed")]
    NoTruth {
        /// The file.
        path: String,
    },
    /// Where the laser was is not told.
    #[error("{path}: {MOUNT} does not say where {LASER_FRAME} is on {BASE_FRAME}: a bag of anytime simulate is needed")]
    NoMount {
        /// The file.
        path: String,
    },
}

/// Which cells of the world of a simulated drive its rays truly met, by their numbers: first of all on their ways from where the laser truly
/// was, whatever was measured, and whoever stood in between. All rays of a scan are taken to be of its stamp.
pub fn cells_met(bag: &Bag, world: &OccupancyGrid) -> Result<Vec<bool>, NoTrueViews> {
    let path = || bag.path().display().to_string();
    [bag.expect_topic::<PoseStamped>(TRUTH), bag.expect_topic::<LaserScan>(SCANS), bag.expect_topic::<TFMessage>(MOUNT)]
        .into_iter()
        .collect::<Result<(), _>>()?;
    let (mut poses, mut scans, mut frames) = (BTreeMap::new(), BTreeMap::new(), TransformTree::default());
    for message in bag.messages(Some(&[TRUTH, SCANS, MOUNT])) {
        let message = message?;
        match message.connection.topic.as_str() {
            TRUTH => {
                let PoseStamped { header, pose } = message.decode()?;
                let map_from_base = Pose2::new(pose.position.x, pose.position.y, pose.orientation.yaw());
                poses.insert(Stamp::from(header.stamp), map_from_base);
            }
            SCANS => {
                let scan: LaserScan = message.decode()?;
                let beams = BeamGeometry::new(scan.angle_min.into(), scan.angle_increment.into(), scan.ranges.len());
                scans.insert(Stamp::from(scan.header.stamp), (beams, f64::from(scan.range_max)));
            }
            _ => _ = frames.add(&message.decode()?),
        }
    }
    let mount = frames.mount(BASE_FRAME, LASER_FRAME).ok_or_else(|| NoTrueViews::NoMount { path: path() })?;
    let views = scans.iter().filter_map(|(stamp, view)| Some((*poses.get(stamp)? * mount.base_from_laser, view)));
    let (mut met, mut is_none) = (vec![false; world.cells().len()], true);
    for (map_from_laser, (beams, range_max)) in views {
        meet(world, &map_from_laser, beams, *range_max, &mut met);
        is_none = false;
    }
    if is_none { Err(NoTrueViews::NoTruth { path: path() }) } else { Ok(met) }
}

/// Notes the cells that the rays of a scan meet.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // columns and rows of the map
fn meet(world: &OccupancyGrid, map_from_laser: &Pose2, beams: &BeamGeometry, range_max: f64, met: &mut [bool]) {
    // A ray that has gone so far is on a cell's edge.
    let inside = 1e-6 * world.resolution();
    let (laser, turn) = (map_from_laser.translation(), map_from_laser.transform());
    for direction in beams.directions().iter().map(|&direction| turn.rotate(direction)) {
        if let Some(range) = world.range(laser, direction, range_max) {
            let place = world.coordinates(laser + direction * (range + inside));
            if let Some(cell) = met.get_mut(place.y as usize * world.width() + place.x as usize) {
                *cell = true;
            }
        }
    }
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
            SimulatedMessage::Mount(message) => bag.write_latched(MOUNT, time, &message)?,
            SimulatedMessage::Odometry(message) => {
                bag.write("/tf", time, &transform(&message))?;
                bag.write("/odom", time, &message)?;
            }
            SimulatedMessage::Truth { stamp, map_from_base } => {
                truth.write(&StampedPose { stamp, pose: map_from_base }).map_err(RecordError::Truth)?;
                bag.write(TRUTH, time, &truth_message(stamp, map_from_base))?;
            }
            SimulatedMessage::Scan(message) => {
                scans += 1;
                bag.write(SCANS, time, &message)?;
            }
        }
        Ok(())
    })?;
    truth.flush().map_err(RecordError::Truth)?;
    bag.finish()?;
    Ok(scans)
}
