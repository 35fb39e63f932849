//! What the matching thread hands to the map, and what it takes from there. Neither makes it wait.

use std::sync::mpsc::{Sender, SyncSender, TrySendError};
use std::sync::{Arc, Mutex, PoisonError};

use crate::app::sensed::Sensed;
use crate::app::{App, Estimate};
use crate::geometry::Pose2;
use crate::mapping::{Passage, Sighting};
use crate::odometry::Outcome;
use crate::ros::diagnostics::Monitor;
use crate::ros::services::Reply;
use crate::scan::Scan;

/// A robot that has moved by less, m ...
const STILL: f64 = 0.05;
/// ... and rad, sees nothing new.
const STILL_TURN: f64 = 0.05;

/// A condition of this node.
const OVERLOADED: &str = "the map does not keep up: some scans are not drawn";

/// What the mapping thread is to do.
pub(super) enum Order {
    /// Take a scan of a run, and the scan as it was measured.
    Add(u64, Box<(Sighting, Scan)>),
    /// Save the map, and say how that went.
    Save(Sender<Reply>),
    /// End.
    End,
}

/// Number of a run of the odometry, and where its frame is on the map.
pub(super) type Place = Arc<Mutex<(u64, Pose2)>>;

/// The way from the matching thread to the map.
pub(in crate::ros) struct MapFeed {
    orders: SyncSender<Order>,
    place: Place,
    monitor: Arc<Monitor>,
    run: u64,
    /// How the robot has come here since the last scan that was sent.
    passage: Passage,
    last_sent: Option<Pose2>,
}

impl MapFeed {
    pub(super) fn new(orders: SyncSender<Order>, place: Place, monitor: Arc<Monitor>) -> Self {
        Self { orders, place, monitor, run: 0, passage: Passage::Start, last_sent: None }
    }

    /// Puts an answer where the graph has its odometry's frame: a run that the map has not heard of begins where it says.
    pub(in crate::ros) fn place(&mut self, estimate: &mut Estimate) {
        self.run += u64::from(estimate.registration.outcome == Outcome::First);
        let (run, map_from_odom) = *self.place.lock().unwrap_or_else(PoisonError::into_inner);
        estimate.registration.map_from_odom = if run == self.run { map_from_odom } else { Pose2::IDENTITY };
    }

    /// Hands a scan that has been answered to the map, unless the robot stands still.
    pub(in crate::ros) fn send(&mut self, message: &Sensed, estimate: &Estimate, app: &mut App) {
        match estimate.passage() {
            None => return,
            Some(Passage::Start) => self.passage = Passage::Start,
            Some(Passage::Lost) if self.passage == Passage::Known => self.passage = Passage::Lost,
            Some(_) => {}
        }
        let pose = estimate.registration.odom_from_base;
        let moved = self.last_sent.map(|last| last.between(&pose));
        if self.passage == Passage::Known && moved.is_some_and(|moved| moved.distance() < STILL && moved.theta.abs() < STILL_TURN)
        {
            return;
        }
        let Some((sighting, measured)) = app.sighting(message, estimate) else { return };
        let sighting = Sighting { passage: self.passage, ..sighting };
        match self.orders.try_send(Order::Add(self.run, Box::new((sighting, measured)))) {
            Ok(()) => {
                (self.passage, self.last_sent) = (Passage::Known, Some(pose));
                self.monitor.set_condition(OVERLOADED, false);
            }
            Err(TrySendError::Full(_)) => self.monitor.set_condition(OVERLOADED, true),
            Err(TrySendError::Disconnected(_)) => {} // the node is ending
        }
    }
}
