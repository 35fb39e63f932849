//! Exchange between the matching thread and the mapping thread. Neither waits for the other.

use std::sync::mpsc::{Sender, SyncSender, TrySendError};
use std::sync::{Arc, Mutex};

use crate::app::sensed::SensorMessage;
use crate::app::{App, Estimate};
use crate::geometry::Pose2;
use crate::mapping::{MotionStatus, PosedScan};
use crate::odometry::Outcome;
use crate::parallel::lock;
use crate::ros::diagnostics::Monitor;
use crate::ros::services::Reply;
use crate::scan::Scan;

/// Minimum distance between two scans that are sent to the map, m.
const MIN_DISTANCE: f64 = 0.05;
/// Minimum rotation between two scans that are sent to the map, rad.
const MIN_ROTATION: f64 = 0.05;

/// The mapping thread is too slow.
const OVERLOADED: &str = "the mapping thread cannot keep up: some scans are missing from the map";

/// A command to the mapping thread.
pub(super) enum MapCommand {
    /// Add a scan of an odometry run, and the scan as it was measured.
    Add(u64, Box<(PosedScan, Scan)>),
    /// Save the map and send the outcome.
    Save(Sender<Reply>),
    /// End the thread.
    End,
}

/// Number of the odometry run, and the pose of its frame on the map.
pub(super) type SharedMapFromOdom = Arc<Mutex<(u64, Pose2)>>;

/// The matching thread's end of the exchange.
pub(in crate::ros) struct MapFeed {
    commands: SyncSender<MapCommand>,
    map_from_odom: SharedMapFromOdom,
    monitor: Arc<Monitor>,
    run: u64,
    /// How well the motion since the last sent scan is known.
    motion_status: MotionStatus,
    last_sent: Option<Pose2>,
}

impl MapFeed {
    pub(super) fn new(commands: SyncSender<MapCommand>, map_from_odom: SharedMapFromOdom, monitor: Arc<Monitor>) -> Self {
        Self { commands, map_from_odom, monitor, run: 0, motion_status: MotionStatus::Start, last_sent: None }
    }

    /// Sets the pose of the odometry frame in an estimate to that of the pose graph. A run that the map does not know yet starts
    /// at the identity.
    pub(in crate::ros) fn set_map_from_odom(&mut self, estimate: &mut Estimate) {
        self.run += u64::from(estimate.registration.outcome == Outcome::First);
        let (run, map_from_odom) = *lock(&self.map_from_odom);
        estimate.registration.map_from_odom = if run == self.run { map_from_odom } else { Pose2::IDENTITY };
    }

    /// Sends a processed scan to the mapping thread, unless the robot stands still.
    pub(in crate::ros) fn send(&mut self, message: &SensorMessage, estimate: &Estimate, app: &mut App) {
        match estimate.motion_status() {
            None => return,
            Some(MotionStatus::Start) => self.motion_status = MotionStatus::Start,
            Some(MotionStatus::Lost) if self.motion_status == MotionStatus::Known => self.motion_status = MotionStatus::Lost,
            Some(_) => {}
        }
        let pose = estimate.registration.odom_from_base;
        let moved = self.last_sent.map(|last| last.between(&pose));
        if self.motion_status == MotionStatus::Known
            && moved.is_some_and(|moved| moved.distance() < MIN_DISTANCE && moved.theta.abs() < MIN_ROTATION)
        {
            return;
        }
        let Some((posed_scan, measured)) = app.posed_scan(message, estimate) else { return };
        let posed_scan = PosedScan { motion_status: self.motion_status, ..posed_scan };
        match self.commands.try_send(MapCommand::Add(self.run, Box::new((posed_scan, measured)))) {
            Ok(()) => {
                (self.motion_status, self.last_sent) = (MotionStatus::Known, Some(pose));
                self.monitor.set_condition(OVERLOADED, false);
            }
            Err(TrySendError::Full(_)) => self.monitor.set_condition(OVERLOADED, true),
            Err(TrySendError::Disconnected(_)) => {} // the node is ending
        }
    }
}
