//! A controller that sets the time contract of the scan matcher.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::knobs::KnobGroup as _;
use anytime_scan_matcher::ros::contract_demo::{self, ContractDemoKnobs};
use node_program::{NodeProgram, own_arguments};

const USAGE: &str = "\
Sets the time contract of the scan matcher according to the robot's speed (short when it is fast) and logs how well the contract is
kept. A ROS 1 node; if there is no master yet, it waits for one.

Usage: contract_demo [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  icp/odom, icp_state, icp_report
Publishes:      icp_contract

Parameters, in the node's private namespace (such as ~budget_fast):";

fn main() -> ExitCode {
    let parameters = ContractDemoKnobs::default().table().into_iter().map(|knob| (knob.name.into(), knob)).collect();
    NodeProgram { name: "contract_demo", usage: USAGE, parameters, run: contract_demo::run }.main(&own_arguments())
}
