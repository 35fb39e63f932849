//! What the thread of a node works with.

use std::sync::Arc;
use std::time::Duration;

use super::diagnostics::{MOUNT_ASSUMED, Monitor};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::Mailbox;
use super::priority::Urgency;
use super::reader::Reader;
use crate::anytime::clock::Clock;
use crate::app::MountSource;
use crate::transforms::Mount;

/// Transforms may come a little later than the first scans do.
const MOUNT_TIMEOUT: Duration = Duration::from_secs(2);

/// What the thread of a node shares with its others.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) mailbox: Arc<Mailbox>,
    pub(super) interrupts: Arc<Interrupts>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) monitor: Arc<Monitor>,
    pub(super) log: Log,
}

/// What an algorithm works with.
pub(super) struct Context {
    pub(super) shared: Shared,
    pub(super) reader: Reader,
    /// Of this thread.
    pub(super) urgency: Urgency,
    mount_told: Option<MountSource>,
    first_answer: Option<Duration>,
}

impl Context {
    /// Of the thread that calls.
    pub(super) fn new(shared: Shared) -> Self {
        let reader = Reader::new(&shared.clock, &shared.log, &shared.monitor);
        Self { shared, reader, urgency: Urgency::of_this_thread(), mount_told: None, first_answer: None }
    }

    /// Says so if answers cannot go before other programs.
    pub(super) fn tell_priority(&self) {
        if !self.urgency.is_permitted() {
            self.shared
                .log
                .info("real-time priority is not permitted (CAP_SYS_NICE, or ulimit -r): busy programs can make answers late");
        }
    }

    /// Says once where the laser's place is known from, or that it is not.
    pub(super) fn watch_mount(&mut self, (mount, source): (Mount, MountSource)) {
        let now = self.shared.clock.now();
        let waited = now.saturating_sub(*self.first_answer.get_or_insert(now));
        if self.mount_told == Some(source) || (source == MountSource::Assumed && waited < MOUNT_TIMEOUT) {
            return;
        }
        self.mount_told = Some(source);
        self.shared.monitor.set_condition(MOUNT_ASSUMED, source == MountSource::Assumed);
        let place = mount.base_from_laser;
        let head = if mount.upside_down { ", upside down" } else { "" };
        let text = format!("[{:.3} m, {:.3} m, {:.3} rad]{head}", place.x, place.y, place.theta);
        match source {
            MountSource::Parameter => self.shared.log.info(&format!("the laser's place on the base is {text}, by odometry.laser_in_base")),
            MountSource::Transforms => self.shared.log.info(&format!("the laser's place on the base is {text}, by tf")),
            MountSource::Assumed => self.shared.log.warn(
                "the laser's place on the base is not known and taken to be the base's origin: set the parameter \
                 odometry.laser_in_base to [x, y, yaw], or publish the transform from the base frame to the laser's on /tf_static",
            ),
        }
    }

    /// Says what is odd in the scans.
    pub(super) fn tell(&self, remarks: Vec<String>) {
        for remark in remarks {
            self.shared.log.warn(&format!("scan: {remark}"));
        }
    }
}
