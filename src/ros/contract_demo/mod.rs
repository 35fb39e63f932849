//! A demo controller for the time contract: it requests the contracts of a policy of [`crate::control::policy`] (by default, a
//! shorter time budget the faster the robot drives), and monitors how well the matcher keeps them.
//!
//! ```text
//!  icp/odom ---> speed ---> policy ---> schedule ---> icp_contract
//!  icp_state, icp_report ---> adherence ---> log, CSV
//! ```

mod adherence;
mod contract_chooser;
mod controller;
mod row;
mod schedule;

use std::time::Duration;

use rosrust::api::{Master, Ros};

use self::controller::Controller;
use super::context::Shared;
use super::node::{self, NodeParts};
use super::shutdown::StopSignal;
use super::{NodeError, params};
use crate::anytime::timer::Timer;
use crate::knobs::Seconds;

const NAME: &str = "contract_demo";

crate::knobs! {
    /// Contracts to request, and what to record.
    pub struct ContractDemoKnobs {
        /// Policy that chooses the contracts, as in `anytime drive --policy`: `completion`, `fixed:TIME[,METRES]`,
        /// `by_speed:SLOW,FAST,SPEED`, `table`; unset: by speed, with the next three parameters.
        policy: Option<String> = None;
        /// Time budget at rest.
        budget_slow: Seconds = Seconds(0.010), in 0.00001 to 60, unit "s";
        /// Time budget at `speed_fast` and above; it falls linearly in between.
        budget_fast: Seconds = Seconds(0.002), in 0.00001 to 60, unit "s";
        /// Speed from which on the budget is shortest.
        speed_fast: f64 = 4.0, in 0.01 to 100, unit "m/s";
        /// Profile for the policy `table`: a file written by `anytime profile`.
        profile: Option<String> = None;
        /// Variant of the profile to use.
        variant: String = "projective+point_to_line".into();
        /// Bound on the position error at which matching may stop; 0: no bound.
        translation_error_bound: f64 = 0.0, in 0 to 100, unit "m";
        /// Bound on the heading error at which matching may stop; 0: no bound.
        rotation_error_bound: f64 = 0.0, in 0 to 4, unit "rad";
        /// Time between two log lines about how well the contract is kept.
        log_period: Seconds = Seconds(5.0), in 0.1 to 3600, unit "s";
        /// CSV file with a row for every report; unset: none.
        csv: Option<String> = None;
    }
}

/// Runs the node `contract_demo` until SIGINT, SIGTERM or the master ends it. The process arguments are those of ROS: remappings
/// and private parameters.
pub fn run() -> Result<(), NodeError> {
    node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: ContractDemoKnobs = params::read_group(master, ros.name())?;
    let policy =
        contract_chooser::policy(&knobs).map_err(|(parameter, problem)| params::bad_value(ros.name(), parameter, problem))?;
    let parts = NodeParts::new(ros, master)?;
    let Shared { clock, log, .. } = parts.shared.clone();
    let description = controller::describe(&policy);
    let controller = Controller::new(ros, &clock, policy, &knobs)?;
    let period = Duration::from_secs_f64(knobs.log_period.0);
    let timer = Timer::new(period, clock.now() + period);
    let node = parts.build("controlling", controller, Controller::inputs(), Some(timer))?;
    log.info(&description);
    node.run(stop, || ())
}
