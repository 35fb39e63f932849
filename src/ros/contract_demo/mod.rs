//! A controller that shows the time contract at work: the faster the robot, the less time it gives a scan, and it watches how the
//! matcher keeps to that.
//!
//! ```text
//!  icp/odom ---> speed ---> budget ---> schedule ---> icp_contract
//!  icp_state, icp_report ---> adherence ---> log, CSV
//! ```

mod adherence;
mod budget;
mod controller;
mod csv_file;

use rosrust::api::{Master, Ros};

use self::controller::Controller;
use super::shutdown::StopSignal;
use super::{NodeError, params, shell};
use crate::knobs::Seconds;

const NAME: &str = "contract_demo";

crate::knobs! {
    /// What the controller asks for, and what it writes down.
    pub struct ContractDemoKnobs {
        /// Time budget at rest.
        budget_slow: Seconds = Seconds(0.010), in 0.00001 to 60, unit "s";
        /// Time budget at `speed_fast` and beyond; between rest and there it goes down evenly.
        budget_fast: Seconds = Seconds(0.002), in 0.00001 to 60, unit "s";
        /// The speed that calls for the shortest budget.
        speed_fast: f64 = 4.0, in 0.01 to 100, unit "m/s";
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

impl ContractDemoKnobs {
    /// Whether the budgets fit together.
    fn check(&self) -> Result<(), String> {
        let (slow, fast) = (self.budget_slow.0, self.budget_fast.0);
        if fast <= slow { Ok(()) } else { Err(format!("expected at most budget_slow, {slow}, got {fast}")) }
    }
}

/// Runs the node `contract_demo` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    shell::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: ContractDemoKnobs = params::read_group(master, ros.name())?;
    knobs.check().map_err(|problem| params::refused(ros.name(), "budget_fast", problem))?;
    Controller::start(ros, master, &knobs)?.run(stop);
    Ok(())
}
