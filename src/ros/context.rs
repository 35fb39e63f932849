//! The context that a node's worker thread runs in.

use std::sync::Arc;
use std::time::Duration;

use super::diagnostics::{MOUNT_ASSUMED, Monitor};
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::Mailbox;
use super::priority::RealTimePriority;
use super::reader::Reader;
use crate::anytime::clock::Clock;
use crate::app::MountSource;
use crate::transforms::Mount;

/// Time to wait for the laser's transform before warning: `/tf_static` may arrive after the first scans.
const MOUNT_TIMEOUT: Duration = Duration::from_secs(2);

/// Handles that the worker thread shares with the other threads of the node.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) mailbox: Arc<Mailbox>,
    pub(super) interrupts: Arc<Interrupts>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) monitor: Arc<Monitor>,
    pub(super) log: Log,
}

/// Everything an algorithm may use besides its own state.
pub(super) struct Context {
    pub(super) shared: Shared,
    pub(super) reader: Reader,
    /// Real-time priority of the worker thread.
    pub(super) real_time: RealTimePriority,
    logged_mount: Option<MountSource>,
    first_answer: Option<Duration>,
}

impl Context {
    /// Creates the context of the calling thread.
    pub(super) fn new(shared: Shared) -> Self {
        let reader = Reader::new(&shared.clock, &shared.log, &shared.monitor);
        Self { shared, reader, real_time: RealTimePriority::of_this_thread(), logged_mount: None, first_answer: None }
    }

    /// Logs if real-time priority is not permitted.
    pub(super) fn log_priority(&self) {
        if !self.real_time.is_permitted() {
            self.shared.log.info(
                "no permission for real-time priority: busy programs may delay answers (grant CAP_SYS_NICE or raise ulimit -r)",
            );
        }
    }

    /// Logs once where the mount of the laser on the base is known from, and warns if it is unknown.
    pub(super) fn log_mount(&mut self, (mount, source): (Mount, MountSource)) {
        let now = self.shared.clock.now();
        let waited = now.saturating_sub(*self.first_answer.get_or_insert(now));
        if self.logged_mount == Some(source) || (source == MountSource::Assumed && waited < MOUNT_TIMEOUT) {
            return;
        }
        self.logged_mount = Some(source);
        self.shared.monitor.set_condition(MOUNT_ASSUMED, source == MountSource::Assumed);
        let pose = mount.base_from_laser;
        let roll = if mount.upside_down { ", upside down" } else { "" };
        let text = format!("[{:.3} m, {:.3} m, {:.3} rad]{roll}", pose.x, pose.y, pose.theta);
        match source {
            MountSource::Parameter => self.shared.log.info(&format!("laser mount: {text}, from odometry.laser_in_base")),
            MountSource::Transforms => self.shared.log.info(&format!("laser mount: {text}, from /tf")),
            MountSource::Assumed => self.shared.log.warn(
                "the laser mount is unknown, assuming that the laser is at the base origin: set the parameter \
                 odometry.laser_in_base to [x, y, yaw], or publish the transform from base to laser frame on /tf_static",
            ),
        }
    }

    /// Logs what is unusual about the scans.
    pub(super) fn log_remarks(&self, remarks: Vec<String>) {
        for remark in remarks {
            self.shared.log.warn(&format!("scan: {remark}"));
        }
    }
}
