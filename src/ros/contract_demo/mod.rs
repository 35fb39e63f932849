//! A controller that shows the time contract at work: it asks for what a policy of [`crate::control::policy`] says, by default the less
//! time for a scan the faster the robot, and watches how the matcher keeps to that.
//!
//! ```text
//!  icp/odom ---> speed ---> policy ---> schedule ---> icp_contract
//!  icp_state, icp_report ---> adherence ---> log, CSV
//! ```

mod adherence;
mod asking;
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
    /// What the controller asks for, and what it writes down.
    pub struct ContractDemoKnobs {
        /// How contracts are chosen, as `anytime drive --policy` has it: `completion`, `fixed:TIME[,METRES]`, `by_speed:TIME,TIME,SPEED`, `table`;
        /// unset: by speed, as the next three say.
        policy: Option<String> = None;
        /// Time budget at rest.
        budget_slow: Seconds = Seconds(0.010), in 0.00001 to 60, unit "s";
        /// Time budget at `speed_fast` and beyond; between rest and there it goes down evenly.
        budget_fast: Seconds = Seconds(0.002), in 0.00001 to 60, unit "s";
        /// The speed that calls for the shortest budget.
        speed_fast: f64 = 4.0, in 0.01 to 100, unit "m/s";
        /// The profile that the policy `table` goes by: a file of `anytime profile`.
        profile: Option<String> = None;
        /// The variant of the profile.
        variant: String = "projective+point_to_line".into();
        /// Error of the position that is good enough; 0: no bound.
        translation_error_bound: f64 = 0.0, in 0 to 100, unit "m";
        /// Error of the heading that is good enough; 0: no bound.
        rotation_error_bound: f64 = 0.0, in 0 to 4, unit "rad";
        /// Time between two lines about how the contract is kept.
        log_period: Seconds = Seconds(5.0), in 0.1 to 3600, unit "s";
        /// File to write a row to for every report; unset: none.
        csv: Option<String> = None;
    }
}

/// Runs the node `contract_demo` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: ContractDemoKnobs = params::read_group(master, ros.name())?;
    let policy = asking::policy(&knobs).map_err(|(parameter, problem)| params::refused(ros.name(), parameter, problem))?;
    let parts = NodeParts::new(ros, master)?;
    let Shared { clock, log, .. } = parts.shared.clone();
    let in_words = controller::in_words(&policy);
    let controller = Controller::new(ros, &clock, policy, &knobs)?;
    let period = Duration::from_secs_f64(knobs.log_period.0);
    let timer = Timer::new(period, clock.now() + period);
    let node = parts.build("controlling", controller, Controller::inputs(), Some(timer))?;
    log.info(&in_words);
    node.run(stop, || ())
}
