//! The ROS 1 node.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::ros;
use node_program::NodeProgram;

const USAGE: &str = "\
Matches laser scans and publishes where the robot is. A ROS 1 node; waits for the master when there is none.

Usage: scan_matcher [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  scan, odom, imu/data, vel, icp_contract, icp_interrupt, initialpose, /tf, /tf_static
Publishes:      scan_match_location, icp_state, icp/odom, icp_report, icp/path, scan_match_debug, /tf, /diagnostics
Service:        ~reset

Parameters, in the node's private namespace (~matching/max_iterations), or in the YAML file that ~config names:";

fn main() -> ExitCode {
    let parameters = Config::default().table();
    NodeProgram { name: "scan_matcher", usage: USAGE, parameters, run: ros::run }.main()
}
