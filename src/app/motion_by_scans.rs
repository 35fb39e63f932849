//! How the robot moves by its scans alone, where no odometry covers them.

use std::time::Duration;

use crate::anytime::clock::Clock;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::Interrupt;
use crate::anytime::{Driver, Task};
use crate::config::Config;
use crate::geometry::Pose2;
use crate::odometry::{LaserOdometry, OdometryKnobs};
use crate::scan::Scan;
use crate::time::Stamp;

/// Keyframes of the last 20 m, and of the turns on them; older ones serve no more.
const KEYFRAMES: u32 = 100;
/// Part of the time budget that finding the motion may take; the rest is for what the motion is needed for.
const SHARE: f64 = 0.5;

/// Laser odometry, as far as it is needed to tell the motion from one scan to the next.
pub(super) struct MotionByScans {
    odometry: LaserOdometry,
    costs: CostModel,
    /// The scan taken in last, and where the base was then.
    last: Option<(Stamp, Pose2)>,
}

impl MotionByScans {
    /// With the knobs of the matching.
    pub(super) fn new(config: &Config) -> Self {
        let max_keyframes = config.odometry.max_keyframes.min(KEYFRAMES);
        let knobs = OdometryKnobs { close_loops: false, max_keyframes, initial_pose: Pose2::IDENTITY, ..config.odometry.clone() };
        Self {
            odometry: LaserOdometry::new(&knobs, &config.matching, &config.rejection),
            costs: CostModel::new(config.contract.confidence),
            last: None,
        }
    }

    /// Takes a scan in; the motion of the base since the scan taken at `from`, if that was the last one taken in.
    pub(super) fn motion(
        &mut self,
        scan: &Scan,
        base_from_laser: &Pose2,
        from: Stamp,
        task: Task,
        (clock, interrupt): (&dyn Clock, &dyn Interrupt),
    ) -> Option<Pose2> {
        let before = self.last.take().filter(|(stamp, _)| *stamp == from);
        if before.is_none() {
            self.odometry.restart_at(Pose2::IDENTITY);
        }
        let contract = Contract { time_budget: task.contract.time_budget.map(share), ..Contract::default() };
        let mut driver = Driver::new(Task { contract, ..task }, clock, interrupt, &mut self.costs);
        let found = self.odometry.register_within(scan, base_from_laser, &mut driver).odom_from_base;
        self.costs.learn();
        self.last = Some((scan.stamp(), found));
        before.map(|(_, pose)| pose.between(&found))
    }
}

fn share(budget: Duration) -> Duration {
    budget.mul_f64(SHARE)
}
