//! The robot's motion from scan matching alone, for the times that no odometry covers.

use std::time::Duration;

use crate::anytime::clock::Clock;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::Interrupt;
use crate::anytime::{ContractRunner, ScanContract};
use crate::config::Config;
use crate::geometry::Pose2;
use crate::odometry::{LaserOdometry, OdometryKnobs};
use crate::scan::Scan;
use crate::time::Stamp;

/// Maximum number of keyframes: those of the last 20 m and its turns. Older ones are useless here.
const MAX_KEYFRAMES: u32 = 100;
/// Fraction of the time budget for this motion estimate. The rest is for the particle filter, which needs the motion.
const BUDGET_FRACTION: f64 = 0.5;

/// Laser odometry that only provides the motion between consecutive scans.
pub(super) struct ScanMotion {
    odometry: LaserOdometry,
    costs: CostModel,
    /// Stamp of the last processed scan, and the pose of the base at that time.
    last: Option<(Stamp, Pose2)>,
}

impl ScanMotion {
    /// Uses the matching parameters of the configuration.
    pub(super) fn new(config: &Config) -> Self {
        let max_keyframes = config.odometry.max_keyframes.min(MAX_KEYFRAMES);
        let knobs = OdometryKnobs { close_loops: false, max_keyframes, initial_pose: Pose2::IDENTITY, ..config.odometry.clone() };
        Self {
            odometry: LaserOdometry::new(&knobs, &config.matching, &config.rejection),
            costs: CostModel::new(config.contract.confidence),
            last: None,
        }
    }

    /// Matches a scan. Returns the motion of the base since the scan with the stamp `from`, if that was the last one matched
    /// here.
    pub(super) fn motion(
        &mut self,
        scan: &Scan,
        base_from_laser: &Pose2,
        from: Stamp,
        scan_contract: ScanContract,
        (clock, interrupt): (&dyn Clock, &dyn Interrupt),
    ) -> Option<Pose2> {
        let before = self.last.take().filter(|(stamp, _)| *stamp == from);
        if before.is_none() {
            self.odometry.restart_at(Pose2::IDENTITY);
        }
        let contract = Contract { time_budget: scan_contract.contract.time_budget.map(fraction_of), ..Contract::default() };
        let mut runner = ContractRunner::new(ScanContract { contract, ..scan_contract }, clock, interrupt, &mut self.costs);
        let odom_from_base = self.odometry.register_within(scan, base_from_laser, &mut runner).odom_from_base;
        self.costs.learn();
        self.last = Some((scan.stamp(), odom_from_base));
        before.map(|(_, pose)| pose.between(&odom_from_base))
    }
}

fn fraction_of(budget: Duration) -> Duration {
    budget.mul_f64(BUDGET_FRACTION)
}
